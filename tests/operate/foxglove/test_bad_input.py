"""Viewers that send what they should not: the robots stand, the other viewers see on, the log stays short."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.operate.foxglove import LiveView
from eal_actors.operate.foxglove.viewer_control import ViewerControl
from tests.log_lines import log_lines
from tests.operate.foxglove.test_live_view import fleet_of
from tests.operate.foxglove.viewer import Viewer
from tests.plugin_files import write_plugin
from tests.unit.plugins.ros2.rig import wait_for

ADVERTISED = [{"id": 7, "topic": "/r1/cmd_vel", "encoding": "json", "schemaName": "geometry_msgs/Twist"}]
WRONG = (
    b"",
    b"\xff\xfe",
    b"null",
    b"[" * 100_000,
    b'{"linear": {"x": NaN}, "angular": {"z": 0}}',
    b'{"linear": {"x": "nan"}, "angular": {"z": 0}}',
    b'{"linear": {"x": 1e999}, "angular": {"z": 0}}',
    b'{"linear": {"x": 1' + b"0" * 400 + b'}, "angular": {"z": 0}}',
    b'{"linear": {"x": [1]}, "angular": {"z": 0}}',
    b'{"linear": {"x": "' + b"9" * 1_000_000 + b'"}, "angular": {"z": 0}}',
)


@pytest.fixture
def view(tmp_path: Path) -> Iterator[tuple[Fleet, LiveView]]:
    with fleet_of(tmp_path, 2) as fleet, LiveView(fleet, port=0, allow_control=True) as made:
        yield fleet, made


def sees(viewer: Viewer, count: int = 5) -> None:
    """Wait for new transforms."""
    messages = viewer.messages()
    for _ in range(count):
        next(messages)


def test_wrong_velocities_move_nothing(view: tuple[Fleet, LiveView]) -> None:
    fleet, live = view
    begin = fleet["r1"]["TruePose"].get_value().get().value
    with log_lines() as lines, Viewer(live.url) as other, Viewer(live.url) as viewer:
        other.subscribe("/tf")
        viewer.send(op="advertise", channels=ADVERTISED)
        for wrong in WRONG * 20:
            viewer.publish_bytes(7, wrong)
        viewer.publish_bytes(99, b"{}")
        wait_for(lambda: lines.getvalue().count("velocity is ignored") >= 10, "nothing is said")
        sees(other)
    assert fleet["r1"]["TruePose"].get_value().get().value == pytest.approx(begin, abs=1e-9)
    assert lines.getvalue().count("velocity is ignored") < 30
    assert "Traceback" not in lines.getvalue()


def test_messages_to_no_channel_write_few_lines(view: tuple[Fleet, LiveView], caplog: pytest.LogCaptureFixture) -> None:
    """The server writes a line for each, which would fill a disk."""
    _, live = view
    with Viewer(live.url) as viewer:
        for _ in range(400):
            viewer.publish_bytes(99, b"{}")
        viewer.subscribe("/tf")
        sees(viewer)
    lines = [record.getMessage() for record in caplog.records if "unknown channel" in record.getMessage()]
    assert 1 <= len(lines) <= 50, len(lines)


def test_a_flood_of_velocities_ends_with_its_viewer(view: tuple[Fleet, LiveView]) -> None:
    """10,000 messages as fast as they go; the robot halts, and another robot answers meanwhile."""
    fleet, live = view
    with Viewer(live.url) as other:
        other.subscribe("/tf")
        with Viewer(live.url) as viewer:
            viewer.send(op="advertise", channels=ADVERTISED)
            for number in range(10_000):
                viewer.publish(7, {"linear": {"x": 0.1}, "angular": {"z": 0.0}})
                if number % 1000 == 0:
                    assert fleet["r2"]["Base"].get_status(timeout_s=5.0).get() == 0
            sees(other)
        wait_for(lambda: fleet["r1"]["Base"].get_status().get() == 0, "it drives on")
        sees(other)


def test_wrong_frames_end_at_most_their_own_viewer(view: tuple[Fleet, LiveView]) -> None:
    fleet, live = view
    wrongs: tuple[Any, ...] = (
        "no JSON",
        "[]",
        '{"op": "fly"}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 999999}]}',
        '{"op": "setParameters", "parameters": [{"name": "r1.Base.speed_m_s", "value": {"a": [1]}}], "id": "x"}',
        '{"op": "setParameters", "parameters": [{"name": "nobody.Base.x", "value": 1}, {"name": "", "value": 1}]}',
        json.dumps({"op": "getParameters", "parameterNames": ["x" * 1_000_000, "r1.Base.speed_m_s"], "id": "y"}),
        json.dumps({"op": "advertise", "channels": [{**ADVERTISED[0], "id": n} for n in range(2000)]}),
        b"\xff" * 1_000_000,
        struct.pack("<BI", 1, 7),
        b"\x01",
        b"",
    )
    with Viewer(live.url) as other:
        other.subscribe("/tf")
        for wrong in wrongs:
            with Viewer(live.url) as viewer:
                viewer.send_raw(wrong)
            sees(other)
        with socket.create_connection(("127.0.0.1", int(live.url.rpartition(":")[2]))) as stranger:
            with contextlib.suppress(ConnectionError):  # the server may hang up before all of it is sent
                stranger.sendall(b"\x00" * 1_000_000)
            sees(other)
    assert fleet["r1"]["Base"].get_status().get() == 0


def test_a_viewer_that_never_reads_delays_nobody(view: tuple[Fleet, LiveView]) -> None:
    _, live = view
    with Viewer(live.url) as lazy, Viewer(live.url) as other:
        lazy.subscribe("/tf", "/r1/Camera", "/state")
        other.subscribe("/tf")
        end_s = REAL_TIME.now() + 3.0
        while REAL_TIME.now() < end_s:
            sees(other)


def test_unknown_parameters_are_left_out(view: tuple[Fleet, LiveView]) -> None:
    fleet, live = view
    with Viewer(live.url) as viewer:
        names = [f"r1.Base.{config.name}" for config in fleet["r1"]["Base"].info.configs]
        viewer.send(op="getParameters", parameterNames=[*names, "r1.Base.nothing", "x"], id="all")
        while not set(names) <= set(viewer.parameters):
            viewer.receive()


PROBES = """
from eal_actors.plugin import *

class Good(Resource):
    types = ResourceType.ACTUATOR

    @config("speed_m_s", ValueInfo(DataType.DOUBLE))
    def speed_m_s(self):
        return 0.5

class Broken(Resource):
    types = ResourceType.SENSOR

    def open(self):
        raise OSError("it is broken")
"""


def test_a_robot_that_did_not_start_hides_no_parameters_of_others(tmp_path: Path) -> None:
    write_plugin(tmp_path, "good", PROBES, "Good")
    write_plugin(tmp_path, "broken", PROBES, "Broken")
    robots: dict[str, object] = {"q": {"plugins": {"broken": {}}}, "r": {"plugins": {"good": {}}}}
    (tmp_path / "f.yaml").write_text(json.dumps({"version": 1, "plugin_dirs": ["plugins"], "robots": robots}))
    with Fleet.load(tmp_path / "f.yaml").connect() as fleet:
        found = ViewerControl(fleet).on_get_parameters(None, [])
    assert [parameter.name for parameter in found] == ["r.Good.speed_m_s"]
