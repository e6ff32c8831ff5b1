"""ValuePoller: the live values of the robots whose pages are open.

It asks the resources with a small value twice a second, and nothing while nobody looks. As in `fleet_poller`, an open
question is not asked again, and has no deadline of its own.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceInfo, ResourceType
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError, RobotNotFoundError, message_of
from eal_actors.operate.dashboard.state_store import StateStore

VALUE_PERIOD_S: Final = 0.5
"""Real seconds between two questions to a resource."""
MAX_NUMBERS: Final = 16
"""Numbers of a value that is shown; longer arrays are not."""
SILENT_S: Final = 2.0
"""Real seconds after which an open question is reported."""
_MAX_CHARACTERS: Final = 200
_DIGITS: Final = 6


def infos_of(robot: RobotHandle) -> Iterator[tuple[str, ResourceInfo]]:
    """Yield the descriptions of those of the robot's resources that have started."""
    for name, resource in robot.items():
        try:
            yield name, resource.info
        except EALError:
            continue


def is_live(info: ResourceInfo) -> bool:
    """Return whether a resource has a value that is small, and free to read."""
    value = info.value
    if value is None or "get_value" not in info.methods or ResourceType.COMMUNICATION in info.types:
        return False
    return value.type is not DataType.VOID and math.prod(size or 1 for size in value.shape) <= MAX_NUMBERS


class ValuePoller:
    """Reads the values of the watched robots into the store, as cells of the kind `values`.

    Thread: `watch` and `leave` any; `poll` the fleet poller's. None of them blocks.
    """

    def __init__(self, fleet: Fleet, store: StateStore) -> None:
        self._fleet = fleet
        self._store = store
        self._lock = threading.Lock()
        self._watched: dict[str, str] = {}  # robots by browser
        self._renewed: set[str] = set()
        self._readers: dict[str, _RobotReader] = {}
        self._due_s = 0.0

    def watch(self, browser: str, robot: str | None) -> None:
        """Choose the robot of a browser, in place of the previous one; its next values are sent in full.

        Raises RobotNotFoundError if the fleet has no such robot.
        """
        if robot is not None and robot not in self._fleet:
            raise RobotNotFoundError(f"there is no robot {robot!r}")
        with self._lock:
            if robot is None:
                self._watched.pop(browser, None)
            else:
                self._watched[browser] = robot
                self._renewed.add(robot)

    def leave(self, browser: str) -> None:
        """Forget a closed browser."""
        self.watch(browser, None)

    def poll(self, now_s: float) -> None:
        """Poll the values that are due, and store the answers."""
        with self._lock:
            watched = set(self._watched.values()) & self._fleet.keys()
            renewed, self._renewed = self._renewed & watched, set()
        for name in self._readers.keys() - watched:
            del self._readers[name]
            self._store.remove("values", name)
        for name in renewed:
            self._store.remove("values", name)
        is_due = now_s >= self._due_s or bool(renewed)
        if is_due:
            self._due_s = now_s + VALUE_PERIOD_S
        for name in watched:
            reader = self._reader(name)
            if is_due:
                reader.ask(now_s)
            if is_due or reader.is_complete():
                self._store.put("values", {name: reader.take(now_s)})

    def _reader(self, name: str) -> _RobotReader:
        robot, reader = self._fleet[name], self._readers.get(name)
        if reader is None or reader.robot is not robot:
            reader = self._readers[name] = _RobotReader(robot)
        return reader


@dataclass
class _Question:
    """An open question to a resource."""

    answer: Future[EALData]
    asked_s: float


@dataclass
class _RobotReader:
    """The newest values of one robot, and the open questions to it. Thread: the poller's."""

    robot: RobotHandle
    _described: object = None
    _resources: dict[str, ResourceHandle] = field(default_factory=dict)
    _questions: dict[str, _Question] = field(default_factory=dict)
    _values: dict[str, dict[str, Any]] = field(default_factory=dict)
    _is_new: bool = False

    def ask(self, now_s: float) -> None:
        """Read the values that are known without asking, and ask for the others."""
        self._read_description()
        if self.robot.state is not RobotState.READY:
            return
        self._is_new = True
        for name, resource in list(self._resources.items()):
            if name in self._questions or name in self.robot.not_ready:
                continue
            if (seen := resource.glance()) is None:
                self._questions[name] = _Question(resource.get_value(), now_s)
            else:
                self._keep(name, seen)

    def is_complete(self) -> bool:
        """Return whether the last questions have all been answered since the last `take`."""
        return self._is_new and all(question.answer.done() for question in self._questions.values())

    def take(self, now_s: float) -> dict[str, Any]:
        """Return the newest values by resource: each with its stamp, its error, or how long it has been silent."""
        self._is_new = False
        for name, question in list(self._questions.items()):
            if not question.answer.done():
                continue
            del self._questions[name]
            if (error := question.answer.exception()) is None:
                self._keep(name, question.answer.get())
            else:
                self._values[name] = {"error": message_of(error)}
        return {name: {**self._values.get(name, {}), **self._silence(name, now_s)} for name in self._resources}

    def _silence(self, name: str, now_s: float) -> dict[str, Any]:
        question = self._questions.get(name)
        silent_s = 0.0 if question is None else now_s - question.asked_s
        return {"silent_s": int(silent_s)} if silent_s >= SILENT_S else {}

    def _keep(self, name: str, data: EALData) -> None:
        value = _to_plain(data.value)
        if isinstance(value, list) and len(value) > MAX_NUMBERS:
            self._resources.pop(name, None)  # until the robot is described anew
        else:
            self._values[name] = {"value": value, "stamp_s": None if data.stamp_s is None else round(data.stamp_s, 3)}

    def _read_description(self) -> None:
        robot = self.robot
        current = (robot.starts, robot.state, tuple(robot), tuple(robot.not_ready))
        if current == self._described:
            return
        self._described = current
        self._resources = {name: robot[name] for name, info in infos_of(robot) if is_live(info)}


def _to_plain(value: Any) -> Any:
    """Return a value for JSON: short texts, numbers of few digits, and arrays as flat lists."""
    if isinstance(value, str):
        return value[:_MAX_CHARACTERS]
    if isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}")
    if hasattr(value, "ravel"):
        value = value.ravel().tolist()
    return [_to_plain(item) for item in value] if isinstance(value, Iterable) else None
