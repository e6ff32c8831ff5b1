"""Dashboards of fleets made in the test, and a page without a browser."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.operate.dashboard import Access, Dashboard
from tests.plugin_files import write_plugin

ROOT = Path(__file__).parents[3]
SIM = ROOT / "fleets/sim.yaml"
WAIT_S = 60.0
"""Real seconds after which a waiting test fails."""

COUNTING_PLUGIN = """\
import threading

from eal_actors.plugin import ArgumentError, DataType, EALPlugin, Resource, ResourceType, ValueInfo, command


class Base(Resource):
    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.DOUBLE, shape=(2,), description="a twist")

    def __init__(self):
        self.twist, self.halts, self.twists = [0.0, 0.0], 0, 0
        self.changed = threading.Condition()

    def halt(self):
        with self.changed:
            self.twist, self.halts = [0.0, 0.0], self.halts + 1
            self.changed.notify_all()

    def set_value(self, data):
        if data.value[0] > 1.0:
            raise ArgumentError("too fast")
        with self.changed:
            self.twist, self.twists = list(data.value), self.twists + 1
            self.changed.notify_all()

    @command("hold")
    def hold(self):
        while True:
            yield 3600.0

    @command("far")
    def far(self):
        self.progress(0.25, "a quarter")
        while True:
            yield 3600.0

    @command("fail")
    def fail(self):
        raise RuntimeError("<b>wheel</b> fell off")

    @command("turn<degrees>", ValueInfo(DataType.DOUBLE, "deg", 0, 360))
    def turn(self, degrees):
        return 1


class Pose(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,))

    def __init__(self):
        self.asked = 0

    def get_value(self):
        self.asked += 1
        return [self.asked * 0.1, 0.0, 0.0]
"""


def counting_fleet(folder: Path, *robots: str, more: str = "") -> Fleet:
    """Return a fleet of robots whose resources count what they are asked; it is not connected yet.

    Args:
        folder: where its files are.
        robots: their names.
        more: further sections of the fleet file.
    """
    write_plugin(folder, "counting", COUNTING_PLUGIN, "Base", "Pose")
    names = "".join(f"  {name}: {{plugins: {{counting: {{}}}}}}\n" for name in robots)
    file = folder / "fleet.yaml"
    file.write_text(f"version: 1\nname: counted\nplugin_dirs: [plugins]\nrobots:\n{names}{more}")
    return Fleet.load(file)


class Page:
    """A page without a browser: sends messages, and keeps updates."""

    def __init__(self, socket: ClientConnection, token: str | None) -> None:
        self.socket = socket
        self._number = 0
        self.robots: dict[str, Any] = {}
        self.poses: dict[str, Any] = {}
        self.values: dict[str, Any] = {}
        self.paths: list[Any] = []
        self.run: dict[str, Any] = {}
        self.logs: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        self.answers: dict[int | None, dict[str, Any]] = {}
        self.drive_errors: list[dict[str, Any]] = []
        self.say(do="hello", token=token)
        self.hello: dict[str, Any] = json.loads(socket.recv(WAIT_S))["hello"]
        self._began_s = REAL_TIME.now()

    def say(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def drive(self, **message: Any) -> None:
        """Send the message of a held key."""
        self.say(do="drive", heard_s=self.heard_s(), **message)

    def heard_s(self) -> float:
        """Return the fleet's time, as a page knows it that reads all updates at once."""
        return float(self.hello["now_s"] + (REAL_TIME.now() - self._began_s) * self.hello["rate"])

    def ask(self, **message: Any) -> dict[str, Any]:
        """Send a request, and return the answer."""
        self._number += 1
        self.say(**{"heard_s": self.heard_s(), **message}, id=self._number)
        self.hear_until(lambda: self._number in self.answers)
        return self.answers[self._number]

    def hear_until(self, is_so: Callable[[], bool]) -> None:
        """Receive updates until a condition holds; pytest's time-out ends a test in which it never does."""
        while not is_so():
            self._hear()

    def hear_the_end(self) -> int:
        """Receive updates until the server closes the connection; return its code."""
        with pytest.raises(ConnectionClosed) as end:
            self.hear_until(lambda: False)
        assert end.value.rcvd is not None, "the connection broke off"
        return int(end.value.rcvd.code)

    def _hear(self) -> None:
        message = self.socket.recv(WAIT_S)
        if isinstance(message, bytes):
            return
        update = json.loads(message)
        self.robots.update(update.get("robots", {}))
        self.poses.update(update.get("poses", {}))
        self.values.update(update.get("values", {}))
        self.paths += update.get("paths", {}).values()
        self.run = update.get("run", {}).get("", self.run)
        self.logs += update.get("logs", [])
        self.events += update.get("events", [])
        for answer in update.get("answers", []):
            if "drive_error" in answer:
                self.drive_errors.append(answer["drive_error"])
            else:
                self.answers[answer["id"]] = answer


def connect_to(dashboard: Dashboard, **options: Any) -> ClientConnection:
    """Return a connection as from the dashboard's own page, not entered yet."""
    place = dashboard.url.partition("://")[2].rstrip("/")
    scheme = "wss" if dashboard.url.startswith("https") else "ws"
    origin = Origin(dashboard.url.rstrip("/"))
    opened: ClientConnection = connect(f"{scheme}://{place}/ws", origin=origin, compression=None, proxy=None, **options)
    return opened


@contextmanager
def page_of(dashboard: Dashboard, token: str | None = None, **options: Any) -> Iterator[Page]:
    """Yield a page that has sent hello."""
    with connect_to(dashboard, **options) as socket:
        yield Page(socket, token)


def wait_for(base: Any, is_so: Callable[[], bool]) -> None:
    """Wait until a condition of a counting robot's Base holds."""
    with base.changed:
        assert base.changed.wait_for(is_so, WAIT_S), "the condition never held"


def open_dashboard(fleet: Fleet, token: str | None = None, **options: Any) -> Dashboard:
    return Dashboard(fleet, Access("127.0.0.1", token), **options)


def resource_of(fleet: Fleet, robot: str, name: str) -> Any:
    """Return the resource object itself, to read its counts."""
    return fleet[robot][name].resource()
