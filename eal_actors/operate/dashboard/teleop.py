"""Teleop: driving by hand, with a dead-man's switch that halts a robot when its browser's messages stop.

A *press* is one time that keys are held, and has a number. A press that has ended, by a release, by silence or by an
error, stays ended: its late messages, such as after a stall of the connection, are ignored. One browser at a time
drives a robot.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.info import ResourceInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, Clock, new_waiter
from eal_actors.kernel.errors import (
    AccessDeniedError,
    EALError,
    PreemptedError,
    ResourceBusyError,
    StaleCommandError,
    UnsupportedError,
)
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.control import ControlRegistry
from eal_actors.wire.rpc.server.leases import Commanders

SILENCE_S: Final = 0.3
"""Real seconds without a message from the browser after which its robot is halted."""
DRIVE_RESOURCE: Final = "Base"

OnError: TypeAlias = Callable[[str, EALError], None]
"""Called with the robot and the error that ended a press; in any thread, and it must not block."""


class Twist(NamedTuple):
    """Metres and radians per second of the fleet's clock, to the left if positive."""

    speed_m_s: float
    turn_rad_s: float


def takes_twist(info: ResourceInfo) -> bool:
    """Return whether a resource's value is a twist of m/s and rad/s."""
    return "set_value" in info.methods and info.value is not None and info.value.shape == (2,)


@dataclass(frozen=True, slots=True)
class _Press:
    """The current press of a robot."""

    browser: str
    number: int
    on_error: OnError


class Teleop:
    """Drives robots by the messages of browsers.

    Thread: any. Its own thread runs the dead-man's switch between `start` and `close`.
    """

    def __init__(self, fleet: Fleet, control: ControlRegistry, clock: Clock = REAL_TIME) -> None:
        self._fleet = fleet
        self._control = control
        self._clock = clock
        self._lock = threading.Lock()
        self._dead_man = Commanders(SILENCE_S)
        self._presses: dict[str, _Press] = {}
        self._ended: dict[str, int] = {}
        self._waiter = new_waiter()
        self._is_over = False
        self._thread = threading.Thread(target=self._run, name="dashboard teleop", daemon=True)

    def start(self) -> None:
        """Start the dead-man's switch."""
        self._thread.start()

    def close(self) -> None:
        """Halt every robot that is driven, and end. Thread: blocks until the thread has ended."""
        with self._lock:
            self._is_over = True
            robots = list(self._presses)
            for robot in robots:
                self._end_press(robot)
        self._clock.wake(self._waiter)
        self._thread.join()
        for robot in robots:
            self._halt(robot)

    def drive(self, browser: str, robot: str, press: int, twist: Twist, on_error: OnError) -> None:
        """Drive a robot at a twist, until the next message or for SILENCE_S.

        Raises:
            UnsupportedError: the robot takes no twist.
            AccessDeniedError: the robot does not grant this program a twist.
            ResourceBusyError: another browser drives it, or a scenario commands it.
            StaleCommandError: the press has ended.
            EALError: the robot does not exist, or has failed.
        """
        base = self.base_of(robot)
        now_s = self._clock.now()
        self._halt_silent(now_s)
        with self._lock:
            if self._is_over or press <= self._ended.get(browser, -1):
                raise StaleCommandError("release the keys and press them again", robot=robot)
            current = self._presses.get(robot)
            if current is not None and current.browser != browser:
                raise ResourceBusyError("another browser drives it", robot=robot)
            if current is None:
                self._control.drive(robot, DRIVE_RESOURCE, browser)
            self._presses[robot] = _Press(browser, press, on_error)
            self._dead_man.command(browser, robot, now_s)
            answer = base.set_value(list(twist))
        self._clock.wake(self._waiter)
        answer.add_done_callback(lambda done: self._on_answer(robot, browser, press, done))

    def release(self, browser: str, robot: str) -> None:
        """Halt a robot, if the browser drives it. Thread: any; does not block."""
        with self._lock:
            press = self._presses.get(robot)
            if press is None or press.browser != browser:
                return
            self._end_press(robot)
        self._halt(robot)

    def interrupt(self, robot: str) -> None:
        """End the press of a robot whose base gets another command: held keys must not move it again. Thread: any."""
        with self._lock:
            press = self._end_press(robot) if robot in self._presses else None
        if press is not None:
            press.on_error(robot, PreemptedError("by another command", robot=robot))

    def leave(self, browser: str) -> None:
        """Halt every robot that a closed browser drives. Thread: any; does not block."""
        with self._lock:
            robots = [robot for robot, press in self._presses.items() if press.browser == browser]
            for robot in robots:
                self._end_press(robot)
            self._ended.pop(browser, None)
        for robot in robots:
            self._halt(robot)

    def base_of(self, robot: str) -> ResourceHandle:
        """Return the base of a robot that this program may drive; raise as `drive`. Thread: any."""
        handle = self._fleet[robot]
        handle.require_started()
        if DRIVE_RESOURCE not in handle or not takes_twist(handle[DRIVE_RESOURCE].info):
            raise UnsupportedError("cannot be driven by hand: it has no Base that takes a twist", robot=robot)
        base = handle[DRIVE_RESOURCE]
        if (denied := base.denied("set_value")) is not None:
            raise AccessDeniedError(denied, robot=robot, resource=DRIVE_RESOURCE)
        return base

    def _end_press(self, robot: str) -> _Press:
        """Thread: holds the lock."""
        press = self._presses.pop(robot)
        self._ended[press.browser] = max(press.number, self._ended.get(press.browser, -1))
        self._dead_man.halted(robot)
        self._control.undrive(robot, DRIVE_RESOURCE)
        return press

    def _halt(self, robot: str) -> None:
        try:
            done = self._fleet[robot][DRIVE_RESOURCE].halt()
        except EALError as error:
            _log_unhalted(robot, error)
            return
        done.add_done_callback(lambda halted: _log_unhalted(robot, halted.exception()))

    def _on_answer(self, robot: str, browser: str, press: int, answer: Future[int]) -> None:
        """End a press whose twist failed: the robot may still follow the one before. Thread: any."""
        error = answer.exception()
        if not isinstance(error, EALError) or isinstance(error, PreemptedError):  # preempted by the next message
            return
        with self._lock:
            current = self._presses.get(robot)
            if current is None or (current.browser, current.number) != (browser, press):
                return
            self._end_press(robot)
        if not isinstance(error, ResourceBusyError):  # what another controller commands goes on
            self._halt(robot)
        current.on_error(robot, error)

    # The dead-man's switch, in its own thread.

    def _run(self) -> None:
        while not self._is_over:
            self._halt_silent(self._clock.now())
            with self._lock:
                due_s = self._dead_man.due_s
            self._clock.wait(self._waiter, None if due_s == math.inf else max(0.0, due_s - self._clock.now()))

    def _halt_silent(self, now_s: float) -> None:
        with self._lock:
            silent = [silence.resource for silence in self._dead_man.due(now_s)]
            presses = {robot: self._end_press(robot) for robot in silent if robot in self._presses}
        for robot, press in presses.items():
            self._halt(robot)
            get_logger(robot=robot).warning("halted: the browser that drives it sent no message", silence_s=SILENCE_S)
            press.on_error(robot, StaleCommandError(f"no drive message for {SILENCE_S:g} s", robot=robot))


def _log_unhalted(robot: str, error: BaseException | None) -> None:
    if error is not None:
        get_logger(robot=robot).error("could not be halted after driving by hand", reason=str(error))
