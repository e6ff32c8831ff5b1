"""HandDriver: drives robots by a gamepad or a keyboard, with a dead-man that ends on release, silence and unplugging.

The hand's messages go through `Teleop`, so that the robots halt also if this program hangs or its link is lost.
"""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import (
    EALError,
    RobotFailedError,
    StaleCommandError,
    UnavailableError,
    UnsupportedError,
)
from eal_actors.operate.dashboard.control import ControlRegistry
from eal_actors.operate.dashboard.teleop import DRIVE_RESOURCE, Teleop, Twist
from eal_actors.operate.hands.input_device import InputSource
from eal_actors.operate.hands.sticks import EventReader, Sticks

PERIOD_S: Final = 0.1
"""Real seconds between two messages to a robot; the dead-man's switch halts after three missed ones."""
_MOST_BYTES: Final = 1 << 16
"""All that a pipe or a device keeps: of the events of a past stall, only the last state may drive."""

Report = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class HandSettings:
    """The mapping from a stick's deflection to a velocity.

    Attributes:
        speed_m_s: at the stick's end, in m/s of the fleet's clock.
        turn_rad_s: the same for turning, in rad/s.
        expo: the curve, from 0, linear, to 1, cubic.
        silence_s: real seconds without an event after which the robots halt: a wireless gamepad out of reach may
            neither release nor unplug. A hand that holds still for longer presses again.
    """

    speed_m_s: float = 0.2
    turn_rad_s: float = 0.8
    expo: float = 0.6
    silence_s: float = 3.0


class HandDriver:
    """Drives robots until its device is unplugged.

    The group button chooses all of the `robots`, or one after another. Thread: `run` blocks its caller; the dead-man's
    switch has a thread of its own.
    """

    def __init__(self, fleet: Fleet, robots: Sequence[str], settings: HandSettings, report: Report) -> None:
        self._fleet = fleet
        self._groups = [tuple(robots), *((robot,) for robot in robots if len(robots) > 1)]
        self._settings = settings
        self._report = report
        self._registry = ControlRegistry()
        self._teleop = Teleop(fleet, self._registry)
        self._driven: tuple[str, ...] = ()
        self._heard_s = self._sent_s = 0.0

    def run(self, source: InputSource) -> None:
        """Drive by the events of a device.

        Raises UnavailableError if it was unplugged, or its stream has ended, and AccessDeniedError at once if a robot
        does not grant this program to drive it.
        """
        for robot in self._groups[0]:
            with contextlib.suppress(RobotFailedError, UnavailableError, UnsupportedError):  # reported with a press
                self._teleop.base_of(robot)
        sticks, reader = Sticks(source.ranges, self._settings.expo), EventReader()
        self._teleop.start()
        try:
            while True:
                self._read(source, reader, sticks)
                self._follow(sticks)
        finally:
            self._release()
            self._teleop.close()

    def _read(self, source: InputSource, reader: EventReader, sticks: Sticks) -> None:
        """Read the device's events, waiting at most for a period."""
        ready, _, _ = select.select([source.fd], [], [], PERIOD_S)
        if not ready:
            return
        try:
            data = os.read(source.fd, _MOST_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            raise UnavailableError(f"{source.name} was unplugged: {error.strerror}; the robots are halted") from error
        if not data:
            raise UnavailableError(f"the events of {source.name} have ended; the robots are halted")
        before = sticks.group_steps
        for event in reader.feed(data):
            sticks.feed(event)
        self._heard_s = REAL_TIME.now()
        if sticks.group_steps != before:
            self._report(f"driving {', '.join(self._group(sticks))}")

    def _group(self, sticks: Sticks) -> tuple[str, ...]:
        return self._groups[sticks.group_steps % len(self._groups)]

    def _follow(self, sticks: Sticks) -> None:
        """Send the wanted velocity, or halt the robots."""
        now_s = REAL_TIME.now()
        if sticks.is_held and now_s - self._heard_s > self._settings.silence_s:
            sticks.let_go()
            self._report(f"halted: no event for {self._settings.silence_s:g} s; release and press again")
        if not sticks.is_held:
            self._release()
            return
        if now_s < self._sent_s + PERIOD_S / 2:  # a stick sends hundreds of events a second
            return
        self._sent_s = now_s
        ahead, left = sticks.wish()
        twist = Twist(ahead * self._settings.speed_m_s, left * self._settings.turn_rad_s)
        self._driven = self._group(sticks)
        for robot in self._driven:
            try:
                self._teleop.drive(_hand_of(robot), robot, sticks.press, twist, self._on_error)
            except StaleCommandError:  # reported when the press ended
                continue
            except EALError as error:
                self._on_error(robot, error)

    def _release(self) -> None:
        for robot in self._driven:
            self._teleop.release(_hand_of(robot), robot)
            try:
                self._registry.release_idle(self._fleet[robot], [DRIVE_RESOURCE])
            except EALError as error:
                self._report(f"{robot}: its base could not be released: {error.message}")
        self._driven = ()

    def _on_error(self, robot: str, error: EALError) -> None:
        self._report(f"{robot} halted: {error.message}")


def _hand_of(robot: str) -> str:
    """Return the name under which the hand drives a robot: each has presses of its own."""
    return f"hand of {robot}"
