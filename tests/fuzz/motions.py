"""Motions over a noisy wire, judged by the true path: the whole plugin, its base, and the emulator of its device.

A robot moves for some time under faults. What its driver answers is compared with what the body did.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from random import Random
from types import ModuleType
from typing import Any, Final, Protocol
from unittest.mock import patch

from eal_actors.kernel.errors import EALError
from eal_actors.plugin import FleetServices, PluginContext
from tests.due_activities import DueActivities
from tests.fuzz.noisy_wire import ByteDevice, Line, Noise, NoisyWire
from tests.manual_clock import HurriedClock

MOST_ERROR_M: Final = 0.05
MOST_ERROR_DEG: Final = 5.0
HALT_S: Final = 1.0
"""Time from the end of a motion until the robot must stand, whatever the answer was."""
_STANDS_FOR_S: Final = 0.5
_STANDS_M: Final = 0.001
_CREEPS_M: Final = 0.015
"""Travel in _STANDS_FOR_S, or turn in rad, of wheels at 3 mm/s: a count of whole millimetres shows them later."""
_CREEPS_S: Final = 2.0
"""Time for which wheels may creep after that."""
RATES: Final = (0.0005, 0.002, 0.005, 0.01, 0.02)
MOTIONS_A_ROBOT: Final = 10
"""After these a new robot is taken, because damaged bytes may have switched the last one off for good."""


class TrueBody(Protocol):
    """Returns the true position of an emulated robot: x in m, y in m, yaw in rad."""

    @property
    def pose(self) -> tuple[float, float, float]: ...


MakeDevice = Callable[[Callable[[], float], Random], tuple[ByteDevice, TrueBody]]


@dataclass(frozen=True)
class FuzzedDriver:
    """A driver on a wire.

    Attributes:
        name: of the driver, its protocol and its link.
        plugin: the plugin's module, whose `connect` returns a FactoryPlugin with a `Base`.
        settings: of the plugin; the port is `sim://wire`.
        make: makes the device and its body from a function that returns the device's time.
        line: the delays of the wire.
    """

    name: str
    plugin: ModuleType
    settings: Mapping[str, Any]
    make: MakeDevice
    line: Line = Line()  # noqa: RUF009  # it is immutable


@dataclass(frozen=True)
class Motion:
    """A command to the base, what it should do, and when it must have ended."""

    command: str
    distance_m: float = 0.0
    angle_rad: float = 0.0
    deadline_s: float = 10.0

    @classmethod
    def by_chance(cls, random: Random) -> Motion:
        if random.random() < 0.5:
            size = random.uniform(0.05, 0.6)
            letter, sign = random.choice((("f", 1), ("b", -1)))
            return cls(f"{letter}{size:.3f}", distance_m=sign * round(size, 3))
        size = random.uniform(10, 150)
        letter, sign = random.choice((("l", 1), ("r", -1)))
        return cls(f"{letter}{size:.1f}", angle_rad=sign * math.radians(round(size, 1)))


@dataclass(frozen=True)
class MotionResult:
    """The result of a motion.

    Attributes:
        motion: the motion.
        answer: `ok`, the code of the error, or `late`.
        message: the error's message.
        error_m: true distance from the goal.
        error_deg: true angle from the goal, 0 or more.
        stands: whether it stood after HALT_S; if it crept, after _CREEPS_S more.
    """

    motion: Motion
    answer: str
    message: str
    error_m: float
    error_deg: float
    stands: bool

    @property
    def is_wrong(self) -> bool:
        """Whether it claims what is not so, or moves on."""
        is_false = self.answer == "ok" and (self.error_m > MOST_ERROR_M or self.error_deg > MOST_ERROR_DEG)
        return is_false or not self.stands


class FuzzedRobot:
    """A robot behind a noisy wire, on a clock that moves only while something runs. Thread: one.

    Args:
        driver: the driver and its wire.
        seed: of the damage and of the body.
    """

    def __init__(self, driver: FuzzedDriver, seed: int) -> None:
        self.clock = HurriedClock()
        self._driver = driver
        self._random = Random(seed)  # noqa: S311  # it makes faults, not secrets
        self.body: TrueBody
        self.wire: NoisyWire
        services = FleetServices(self.clock, seed, None, lambda *_: self._open_port())
        settings = driver.plugin.Settings.model_validate(dict(driver.settings))
        context = PluginContext("rob", driver.name, settings, services)
        with patch("secrets.randbelow", self._random.randrange):  # a host's identity is in the bytes that are damaged
            self.plugin = driver.plugin.connect(context)
        self.base: Any = self.plugin.makers["Base"]()
        self._activities = DueActivities(self.clock.now, self._pass_until)
        self._activities.begin(self.base.background())

    def _open_port(self) -> NoisyWire:
        def make(now_s: Callable[[], float]) -> ByteDevice:
            device, self.body = self._driver.make(now_s, self._random)
            return device

        self.wire = NoisyWire(make, self.clock.now, self._random, self._driver.line)
        return self.wire

    def close(self) -> None:
        """Halt it, disconnect the plugin and close the wire."""
        self.wire.noise = Noise()
        with suppress(EALError):
            self.base.close()
        with suppress(EALError):
            self._driver.plugin.disconnect(self.plugin)
        self.wire.close()

    # Time.

    def _pass_until(self, until_s: float) -> None:
        self.clock.advance(max(0.0, until_s - self.clock.now()))

    def wait(self, duration_s: float) -> None:
        """Let time pass, with everything at work."""
        self._activities.wait(duration_s)
        self.wire.settle()

    # Motions.

    def move(self, motion: Motion) -> MotionResult:
        """Carry out a motion, then check that it stands."""
        before = self._pose()
        answer, message = self._carry_out(motion)
        after = self._pose()
        error_m, error_deg = _error(motion, before, after)
        self.wait(HALT_S)
        return MotionResult(motion, answer, message, error_m, error_deg, self._stands())

    def _stands(self) -> bool:
        moved_m = self._moved_m()
        if _STANDS_M <= moved_m < _CREEPS_M:  # a damaged stop may be a drive at 1 or 2 mm/s
            self.wait(_CREEPS_S)
            moved_m = self._moved_m()
        return moved_m < _STANDS_M

    def _moved_m(self) -> float:
        """Wait, and return by how far it moved meanwhile, or by how many radians it turned."""
        rests_at = self._pose()
        self.wait(_STANDS_FOR_S)
        return math.dist(rests_at, self._pose())

    def _carry_out(self, motion: Motion) -> tuple[str, str]:
        try:
            activity = self.base.send_cmd(motion.command)
        except EALError as error:
            return error.code, str(error)
        number, end_s = self._activities.begin(activity), self.clock.now() + motion.deadline_s
        while number not in self._activities.results:
            if self._activities.step(end_s):
                continue
            with suppress(EALError):
                self._activities.close(number)
            with suppress(EALError):
                self.base.halt()
            return "late", f"not done after {motion.deadline_s:g} s"
        end = self._activities.results.pop(number)
        return (end.code, str(end)) if isinstance(end, EALError) else ("ok", "")

    def _pose(self) -> tuple[float, float, float]:
        self.wire.settle()
        return self.body.pose


def _error(
    motion: Motion, before: tuple[float, float, float], after: tuple[float, float, float]
) -> tuple[float, float]:
    """Return the distance in m and the angle in degrees between where it is and where it should be."""
    x_m, y_m, yaw_rad = before
    goal = x_m + motion.distance_m * math.cos(yaw_rad), y_m + motion.distance_m * math.sin(yaw_rad)
    off_rad = math.remainder(after[2] - yaw_rad - motion.angle_rad, math.tau)
    return math.dist(goal, after[:2]), abs(math.degrees(off_rad))


@dataclass
class FuzzTable:
    """The results of many motions."""

    answers: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    wrong: list[tuple[int, MotionResult]] = field(default_factory=list)
    worst_m: float = 0.0
    worst_deg: float = 0.0

    def add(self, seed: int, result: MotionResult) -> None:
        self.answers[result.answer] += 1
        if result.answer == "ok":
            self.worst_m, self.worst_deg = max(self.worst_m, result.error_m), max(self.worst_deg, result.error_deg)
        if result.is_wrong:
            self.wrong.append((seed, result))

    def __str__(self) -> str:
        counts = ", ".join(f"{answer} {number:,}" for answer, number in self.answers.most_common())
        return (
            f"{sum(self.answers.values()):,} motions, {sum(self.faults.values()):,} faults: {counts}; "
            f"worst ok {self.worst_m * 100:.1f} cm {self.worst_deg:.1f} deg; wrong: {len(self.wrong)}"
        )


def fuzz(driver: FuzzedDriver, motions: int, seed: int, noise: Noise | None = None) -> FuzzTable:
    """Move robots under faults; each robot has a seed of its own, the first one `seed`.

    Args:
        driver: the driver and its wire.
        motions: number of motions.
        seed: of the first robot.
        noise: the faults; if None, each robot has a rate of its own, of RATES.
    """
    table = FuzzTable()
    for robot_seed in range(seed, seed + math.ceil(motions / MOTIONS_A_ROBOT)):
        robot = FuzzedRobot(driver, robot_seed)
        random = Random(robot_seed)  # noqa: S311
        try:
            robot.wait(0.3)
            robot.wire.noise = noise or Noise(random.choice(RATES))
            for _ in range(MOTIONS_A_ROBOT):
                table.add(robot_seed, robot.move(Motion.by_chance(random)))
        finally:
            robot.close()
        table.faults += robot.wire.damage.counts
    return table
