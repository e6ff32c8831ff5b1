"""The other end: mosquitto as the broker, and a device made with paho alone."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion

from eal_actors import EALError, Fleet
from tests.unit.plugins.ros2.rig import free_port, wait_for

CALL_S = 60.0
"""Deadline of a call on a loaded machine, in seconds."""


def mosquitto() -> str:
    """Return the program; the test is skipped where it is absent."""
    found = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if found is None:
        pytest.skip("mosquitto is not installed")
    return found


class Broker:
    """Mosquitto at a port of its own, which can be stopped and started again.

    Attributes:
        port: its port.
        url: for settings.
    """

    def __init__(self, folder: Path, lines: tuple[str, ...] = ("allow_anonymous true",), scheme: str = "mqtt") -> None:
        self._program = mosquitto()
        self.port = free_port()
        self.url = f"{scheme}://127.0.0.1:{self.port}"
        self._file = folder / f"mosquitto-{self.port}.conf"
        settings = [f"listener {self.port} 127.0.0.1", "user root", "persistence false", "log_type none", *lines]
        self._file.write_text("\n".join([*settings, ""]))
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> Broker:
        self._process = subprocess.Popen([self._program, "-c", str(self._file)], stderr=subprocess.DEVNULL)
        wait_for(self._listens, "mosquitto does not listen")
        return self

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def freeze(self) -> None:
        """Stop the process where it is; its connections stay open."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def __enter__(self) -> Broker:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()


class Device:
    """A device that others could have made: it publishes, and keeps what it hears.

    Args:
        broker: its broker.
        topics: that it subscribes.
        will: topic and message of its last will, retained.
    """

    def __init__(self, broker: Broker, *topics: str, will: tuple[str, str] | None = None) -> None:
        self.heard: list[tuple[str, bytes]] = []
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        if will is not None:
            self._client.will_set(*will, qos=1, retain=True)
        self._client.on_message = lambda _, __, message: self.heard.append((message.topic, bytes(message.payload)))
        self._client.on_subscribe = lambda *_: self._subscribed.append(True)
        self._subscribed: list[bool] = []
        self._client.connect("127.0.0.1", broker.port, 5)
        self._client.loop_start()
        for topic in topics:
            self._client.subscribe(topic, qos=1)
        wait_for(lambda: len(self._subscribed) == len(topics), "the device is not subscribed")

    def say(self, topic: str, message: str | bytes, *, retain: bool = False, qos: int = 1) -> paho.MQTTMessageInfo:
        return self._client.publish(topic, message, qos, retain)

    def break_off(self) -> None:
        """Lose the connection without a farewell, so that the broker publishes the last will."""
        self._client.loop_stop()
        connected = self._client.socket()
        assert connected is not None
        connected.close()

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@contextmanager
def mqtt_fleet(folder: Path, plugin: str = "mqtt", **robots: dict[str, Any]) -> Iterator[Fleet]:
    """Open a fleet of robots of one plugin, from a file."""
    content = {
        "version": 1,
        "name": "mqtt",
        "robots": {name: {"plugins": {plugin: settings}} for name, settings in robots.items()},
    }
    file = folder / "mqtt.yaml"
    file.write_text(json.dumps(content))
    with Fleet.load(file) as fleet:
        yield fleet


def why(fleet: Fleet, robot: str, resource: str, words: str) -> str:
    """Wait until a resource is not ready for a reason with these words; return the reason."""
    wait_for(lambda: words in fleet[robot].not_ready.get(resource, ""), f"{words!r}: {dict(fleet[robot].not_ready)}")
    return fleet[robot].not_ready[resource]


def until_ready(fleet: Fleet, robot: str, *resources: str) -> None:
    wait_for(lambda: not set(resources) & set(fleet[robot].not_ready), f"not ready: {dict(fleet[robot].not_ready)}")


def error_of(call: Callable[[], Any]) -> str:
    """Return the message of the error that a call raises; empty for none."""
    try:
        call()
    except EALError as error:
        return error.message
    return ""
