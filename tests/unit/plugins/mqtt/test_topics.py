"""Topics as resources: the plugin against a device of paho's at a real mosquitto."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.errors import ArgumentError, EALError
from plugins.mqtt.connection import TopicInbox
from plugins.mqtt.resources import MqttReader
from plugins.mqtt.settings import MqttTopicSettings
from tests.manual_clock import ManualClock
from tests.unit.plugins.mqtt.rig import Broker, Device, error_of, mqtt_fleet, until_ready, why
from tests.unit.plugins.ros2.rig import wait_for


def test_values_of_every_kind_are_read_and_published(broker: Broker, tmp_path: Path) -> None:
    topics = {
        "Warmth": {"topic": "room/climate", "value": "number", "field": "now.degrees", "unit": "degC"},
        "Door": {"topic": "room/door", "value": "flag", "on": "OPEN", "off": "SHUT"},
        "Note": {"topic": "room/note"},
        "Climate": {"topic": "room/climate", "value": "json"},
        "Lamp": {"topic": "room/lamp", "value": "flag", "on": "ON", "off": "OFF", "writable": True, "halt": "OFF"},
        "Heat": {"topic": "room/heat", "value": "number", "field": "set.degrees", "writable": True},
    }
    with (
        Device(broker, "room/lamp", "room/heat") as device,
        mqtt_fleet(tmp_path, room={"broker": broker.url, "topics": topics}) as fleet,
    ):
        room = fleet["room"]
        until_ready(fleet, "room", "Lamp", "Heat")
        assert why(fleet, "room", "Note", "no message") == "no message on room/note yet"
        device.say("room/climate", '{"now": {"degrees": 21.5}}')
        device.say("room/door", "OPEN")
        device.say("room/note", "hä?")
        until_ready(fleet, "room", "Warmth", "Door", "Note")
        warmth = room["Warmth"].get_value().get()
        assert (warmth.value, warmth.unit) == (21.5, "degC")
        assert room["Door"].get_value().get().value is True
        assert room["Note"].get_value().get().value == "hä?"
        room["Lamp"].set_value(True).get()
        room["Heat"].set_value(19.0).get()
        room["Lamp"].halt().get()
        wait_for(lambda: len(device.heard) >= 3, "not all was published")
        assert device.heard[:3] == [
            ("room/lamp", b"ON"),
            ("room/heat", b'{"set": {"degrees": 19.0}}'),
            ("room/lamp", b"OFF"),
        ]
        with pytest.raises(ArgumentError):
            room["Heat"].set_value(float("nan")).get()


BAD = (
    (b"warm", "is no JSON"),
    (b'{"degrees": NaN}', "NaN is no number"),
    (b'{"degrees": "NaN"}', "no finite number"),
    (b'{"degrees": 1e999}', "too large for a number"),
    (b'{"degrees": 1' + b"0" * 400 + b"}", "no finite number"),
    (b'{"degrees": 1' + b"0" * 4500 + b"}", "is no JSON"),
    (b'{"degrees": true}', "no finite number"),
    (b'{"degree": 1}', "no field 'degrees'"),
    (b"\xff\xfe", "is no text"),
    (b"[" * 100_000, "longer than 5000 bytes"),
    (b"[" * 5000, "is no JSON"),
    (b"x" * 1_000_000, "longer than 5000 bytes"),
)


def test_bad_messages_are_errors_of_their_resource(broker: Broker, tmp_path: Path) -> None:
    topics = {
        "Warmth": {"topic": "bad/climate", "value": "number", "field": "degrees", "max_bytes": 5000},
        "Note": {"topic": "bad/note"},
    }
    with Device(broker) as device, mqtt_fleet(tmp_path, room={"broker": broker.url, "topics": topics}) as fleet:
        why(fleet, "room", "Note", "no message")

        def error() -> str:
            return error_of(lambda: fleet["room"]["Warmth"].get_value().get())

        for payload, words in BAD:
            device.say("bad/climate", payload)
            wait_for(lambda words=words: words in error(), words)  # type: ignore[misc]
        device.say("bad/note", "fine")
        until_ready(fleet, "room", "Note")
        assert fleet["room"].state is RobotState.READY
        device.say("bad/climate", '{"degrees": 3}')
        wait_for(lambda: not error(), "it does not recover")


def test_what_the_broker_has_retained_ends_no_silence(broker: Broker, tmp_path: Path) -> None:
    """It may be days old, and a broker that is back sends it again."""
    topics = {
        "Live": {"topic": "sensor/live", "value": "number", "timeout_s": 3600},
        "Kept": {"topic": "sensor/kept", "value": "number"},
    }
    with Device(broker, "sensor/live", "sensor/kept") as device:
        device.say("sensor/live", "1", retain=True)
        device.say("sensor/kept", "1", retain=True)
        wait_for(lambda: len(device.heard) == 2, "the broker has not retained them")
        with mqtt_fleet(tmp_path, room={"broker": broker.url, "topics": topics}) as fleet:
            until_ready(fleet, "room", "Kept")
            assert fleet["room"]["Kept"].get_value().get().value == 1
            assert why(fleet, "room", "Live", "retained") == (
                "no message on sensor/live but the one that the broker had retained"
            )
            device.say("sensor/live", "2", retain=True)
            until_ready(fleet, "room", "Live")
            assert fleet["room"]["Live"].get_value().get().value == 2


def test_a_retained_message_that_comes_again_is_as_old_as_before() -> None:
    clock, inbox = ManualClock(), TopicInbox("t", 1, 100)
    reader = MqttReader(MqttTopicSettings(topic="t", timeout_s=10), inbox, clock, lambda: None)
    inbox.put(b"a", clock.now(), is_retained=False)
    first = reader.get_value()
    clock.advance(5.0)
    inbox.put(b"a", clock.now(), is_retained=True)
    assert reader.get_value() == first
    inbox.put(b"b", clock.now(), is_retained=True)
    assert reader.not_ready() == "no message on t but the one that the broker had retained"


@pytest.mark.slow
def test_a_flood_leaves_the_newest_message(broker: Broker, tmp_path: Path) -> None:
    topics = {"Count": {"topic": "flood/count", "value": "number"}}
    with Device(broker) as device, mqtt_fleet(tmp_path, one={"broker": broker.url, "topics": topics}) as fleet:
        why(fleet, "one", "Count", "no message")
        for number in range(10_000):
            device.say("flood/count", str(number), qos=0)
        device.say("flood/count", "-1")  # quality 1: a full queue of the broker may drop the others
        until_ready(fleet, "one", "Count")
        wait_for(lambda: fleet["one"]["Count"].get_value().get().value == -1, "the newest message is not there")


def test_presence_follows_the_last_wills_of_both_sides(broker: Broker, tmp_path: Path) -> None:
    settings = {
        "broker": broker.url,
        "topics": {"Say": {"topic": "box/say", "writable": True}},
        "presence": {"topic": "box/status"},
        "announce": {"topic": "eal/status"},
    }
    with Device(broker, "eal/status") as watcher:
        with mqtt_fleet(tmp_path, box=settings) as fleet:
            assert "says nothing, not 'online'" in why(fleet, "box", "Say", "the device is absent")
            device = Device(broker, will=("box/status", "gone"))
            device.say("box/status", "online", retain=True)
            until_ready(fleet, "box", "Say")
            device.break_off()
            why(fleet, "box", "Say", "box/status says 'gone'")
            wait_for(lambda: ("eal/status", b"online") in watcher.heard, "nothing was announced")
        wait_for(lambda: watcher.heard[-1] == ("eal/status", b"offline"), "no farewell")


def test_a_device_that_goes_with_its_broker_is_absent_when_the_broker_is_back(tmp_path: Path) -> None:
    """The broker, which kept nothing on its disk, never published the last will."""
    settings = {"topics": {"Say": {"topic": "box/say", "writable": True}}, "presence": {"topic": "box/status"}}
    broker = Broker(tmp_path)
    with mqtt_fleet(tmp_path, box={"broker": broker.url, **settings}) as fleet:
        with broker, Device(broker) as device:
            device.say("box/status", "online", retain=True)
            until_ready(fleet, "box", "Say")
        with broker:
            assert "says nothing, not 'online'" in why(fleet, "box", "Say", "the device is absent")
            with Device(broker) as device:
                device.say("box/status", "online", retain=True)
                until_ready(fleet, "box", "Say")


def test_a_broker_that_appears_late_and_goes(tmp_path: Path) -> None:
    """Nothing blocks, nothing is sent later, and the other robot of the fleet is unharmed."""
    late = Broker(tmp_path)
    topics = {"Say": {"topic": "say", "writable": True}}
    with Broker(tmp_path) as other, mqtt_fleet(
        tmp_path, late={"broker": late.url, "topics": topics}, fine={"broker": other.url, "topics": topics}
    ) as fleet:  # fmt: skip
        until_ready(fleet, "fine", "Say")
        reason = why(fleet, "late", "Say", "connection refused")
        assert reason.startswith(f"cannot reach the MQTT broker at {late.url}: ")
        assert error_of(lambda: fleet["late"]["Say"].set_value("lost").get())
        with late, Device(late, "say") as device:
            until_ready(fleet, "late", "Say")
            fleet["late"]["Say"].set_value("first").get()
            wait_for(lambda: bool(device.heard), "nothing arrives")
            assert device.heard == [("say", b"first")]
        why(fleet, "late", "Say", "connection")
        assert fleet["fine"].state is RobotState.READY
        fleet["fine"]["Say"].set_value("x").get()


def make_certificates(folder: Path) -> None:
    """Make an authority and the broker's certificate for 127.0.0.1, with openssl."""
    make = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    make += ["-keyout", "key.pem", "-out", "ca.pem", "-days", "2", "-subj", "/CN=broker"]
    make += ["-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run(make, cwd=folder, check=True, capture_output=True)


def test_a_halt_while_the_broker_is_away_is_published_when_it_is_back(tmp_path: Path) -> None:
    """It is retained, so that a device hears it that is back later."""
    motor = {"topic": "room/motor", "writable": True, "halt": "STOP", "retain": True}
    with (
        Broker(tmp_path) as broker,
        mqtt_fleet(tmp_path, room={"broker": broker.url, "topics": {"Motor": motor}}) as fleet,
    ):
        until_ready(fleet, "room", "Motor")
        fleet["room"]["Motor"].set_value("RUN").get()
        broker.stop()
        why(fleet, "room", "Motor", "cannot reach")
        fleet["room"]["Motor"].halt().get()
        broker.start()
        with Device(broker, "room/motor") as device:
            wait_for(lambda: ("room/motor", b"STOP") in device.heard, "the motor is not stopped")
        assert error_of(lambda: fleet["room"]["Motor"].set_value("RUN").get()) == ""


# The client leaves the socket of a failed handshake to the garbage collector.
@pytest.mark.filterwarnings("ignore:.*SSLSocket:pytest.PytestUnraisableExceptionWarning")
def test_tls_and_passwords(tmp_path: Path) -> None:
    make_certificates(tmp_path)
    other = tmp_path / "other"
    other.mkdir()
    make_certificates(other)
    (tmp_path / "passwords").write_text("ada:geheim\n")
    subprocess.run(["mosquitto_passwd", "-U", str(tmp_path / "passwords")], check=True)
    (tmp_path / "secret").write_text("geheim\n")
    (tmp_path / "wrong").write_text("falsch\n")
    lines = [f"certfile {tmp_path}/ca.pem", f"keyfile {tmp_path}/key.pem", f"password_file {tmp_path}/passwords"]
    with Broker(tmp_path, tuple(lines), scheme="mqtts") as broker:
        good: dict[str, Any] = {
            "broker": broker.url,
            "ca": str(tmp_path / "ca.pem"),
            "username": "ada",
            "password_file": str(tmp_path / "secret"),
            "topics": {"Say": {"topic": "say", "writable": True}},
        }
        robots = {
            "good": good,
            "older": good | {"protocol": "3.1.1"},
            "nobody": good | {"username": None, "password_file": None},
            "guess": good | {"password_file": str(tmp_path / "wrong")},
            "stranger": good | {"ca": str(other / "ca.pem")},
        }
        with mqtt_fleet(tmp_path, "mqtt", **robots) as fleet:
            until_ready(fleet, "good", "Say")
            until_ready(fleet, "older", "Say")
            why(fleet, "nobody", "Say", "it refuses this client: not authorized")
            why(fleet, "guess", "Say", "it refuses this client: not authorized")
            why(fleet, "stranger", "Say", "certificate verify failed")


def test_wrong_settings_are_refused_with_their_place(tmp_path: Path) -> None:
    content = {
        "version": 1,
        "name": "wrong",
        "robots": {
            "a": {"plugins": {"mqtt": {"broker": "http://x", "topics": {"A": {"topic": "a/#"}}}}},
            "b": {"plugins": {"mqtt": {"topics": {}}}},
        },
    }
    file = tmp_path / "wrong.yaml"
    file.write_text(json.dumps(content))
    with pytest.raises(EALError) as caught, Fleet.load(file):
        pass
    for words in ("broker", "wildcards", "topics"):
        assert words in str(caught.value)
