"""Steering by hand, with a dead-man's switch: a robot moves only as long as a browser goes on saying so."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, Clock, new_waiter
from eal_actors.kernel.errors import EALError, PreemptedError, ResourceBusyError, StaleCommandError, UnsupportedError
from eal_actors.kernel.log import get_logger
from eal_actors.net.server.leases import DeadManSwitch
from eal_actors.operate.dashboard.control import Control
from eal_actors.operate.dashboard.watcher import DRIVE_RESOURCE, takes_twist

SILENCE_S: Final = 0.3
"""Real seconds without a word from the browser after which its robot is halted."""

OnTrouble: TypeAlias = Callable[[str, EALError], None]
"""Told the robot, and why it is steered no more; in any thread, and it must not block."""


class Twist(NamedTuple):
    """How to move: metres and radians in a second of the fleet's clock, to the left if positive."""

    speed_m_s: float
    turn_rad_s: float


@dataclass(frozen=True, slots=True)
class _Hold:
    """Who steers a robot, by which grip, and whom to tell of trouble."""

    driver: str
    grip: int
    on_trouble: OnTrouble


class Steering:
    """Carries out what drivers say, and halts what they fall silent about.

    A *grip* is one time that the keys are held. One that has ended, by a release, by silence or by an error, stays
    ended: words of it that come late, such as after a stall of the link, move nothing. One driver at a time steers a
    robot.

    Args:
        fleet: a connected fleet.
        control: who commands what.
        clock: of the dead-man's switch.

    Thread: any; a thread of its own keeps the dead-man's switch between `start` and `close`.
    """

    def __init__(self, fleet: Fleet, control: Control, clock: Clock = REAL_TIME) -> None:
        self._fleet = fleet
        self._control = control
        self._clock = clock
        self._lock = threading.Lock()
        self._dead_man = DeadManSwitch(SILENCE_S)
        self._holds: dict[str, _Hold] = {}
        self._ended: dict[str, int] = {}
        self._waiter = new_waiter()
        self._is_over = False
        self._thread = threading.Thread(target=self._keep, name="dashboard steering", daemon=True)

    def start(self) -> None:
        """Begin to keep the dead-man's switch."""
        self._thread.start()

    def close(self) -> None:
        """Halt what is steered, and end. Thread: blocks until the thread has ended."""
        with self._lock:
            self._is_over = True
            robots = list(self._holds)
            for robot in robots:
                self._drop(robot)
        self._clock.wake(self._waiter)
        self._thread.join()
        for robot in robots:
            self._halt(robot)

    def drive(self, driver: str, robot: str, grip: int, twist: Twist, on_trouble: OnTrouble) -> None:
        """Move a robot by a twist, until the next word or for SILENCE_S.

        Args:
            driver: names the browser.
            robot: the robot's name.
            grip: number of the grip, which grows from grip to grip of a driver.
            twist: how to move.
            on_trouble: see OnTrouble; also called where the robot refuses.

        Raises:
            UnsupportedError: the robot takes no twist.
            ResourceBusyError: another driver steers it.
            StaleCommandError: the grip has ended.
            EALError: the robot does not exist, or has failed.
        """
        base = self._base(robot)
        now_s = self._clock.now()
        self._halt_silent(now_s)
        with self._lock:
            if self._is_over or grip <= self._ended.get(driver, -1):
                raise StaleCommandError("let the keys go and press them again", robot=robot)
            hold = self._holds.get(robot)
            if hold is not None and hold.driver != driver:
                raise ResourceBusyError("another browser steers it", robot=robot)
            if hold is None:
                self._control.take(robot, DRIVE_RESOURCE, driver)
            self._holds[robot] = _Hold(driver, grip, on_trouble)
            self._dead_man.commanded(driver, robot, now_s)
            answer = base.set_value(list(twist))
        self._clock.wake(self._waiter)
        answer.add_done_callback(lambda done: self._heed(robot, driver, grip, done))

    def let_go(self, driver: str, robot: str) -> None:
        """Halt a robot, if the driver steers it. Thread: any; does not block."""
        with self._lock:
            hold = self._holds.get(robot)
            if hold is None or hold.driver != driver:
                return
            self._drop(robot)
        self._halt(robot)

    def leave(self, driver: str) -> None:
        """Halt everything that a driver steers, who is gone. Thread: any; does not block."""
        with self._lock:
            robots = [robot for robot, hold in self._holds.items() if hold.driver == driver]
            for robot in robots:
                self._drop(robot)
            self._ended.pop(driver, None)
        for robot in robots:
            self._halt(robot)

    def _base(self, robot: str) -> ResourceHandle:
        handle = self._fleet[robot]
        handle.require_started()
        if DRIVE_RESOURCE not in handle or not takes_twist(handle[DRIVE_RESOURCE].info):
            raise UnsupportedError("cannot be steered: it has no Base that takes a twist", robot=robot)
        return handle[DRIVE_RESOURCE]

    def _drop(self, robot: str) -> _Hold:
        """End a robot's grip. Thread: holds the lock."""
        hold = self._holds.pop(robot)
        self._ended[hold.driver] = max(hold.grip, self._ended.get(hold.driver, -1))
        self._dead_man.halted(robot)
        self._control.done(robot, DRIVE_RESOURCE)
        return hold

    def _halt(self, robot: str) -> None:
        try:
            done = self._fleet[robot][DRIVE_RESOURCE].halt()
        except EALError as error:
            get_logger(robot=robot).error("could not be halted after steering", reason=error.message)
            return
        done.add_done_callback(lambda halted: _tell_unhalted(robot, halted))

    def _heed(self, robot: str, driver: str, grip: int, answer: Future[int]) -> None:
        """Take notice of how a twist ended. Thread: whichever ends it."""
        error = answer.exception()
        if not isinstance(error, EALError) or isinstance(error, PreemptedError):  # the next word took over
            return
        with self._lock:
            hold = self._holds.get(robot)
            if hold is None or (hold.driver, hold.grip) != (driver, grip):
                return
            self._drop(robot)
        hold.on_trouble(robot, error)

    # The dead-man's switch, in a thread of its own.

    def _keep(self) -> None:
        while not self._is_over:
            self._halt_silent(self._clock.now())
            with self._lock:
                due_s = self._dead_man.due_s
            self._clock.wait(self._waiter, None if due_s is None else max(0.0, due_s - self._clock.now()))

    def _halt_silent(self, now_s: float) -> None:
        with self._lock:
            silent = [silence.resource for silence in self._dead_man.due(now_s)]
            holds = {robot: self._drop(robot) for robot in silent if robot in self._holds}
        for robot, hold in holds.items():
            self._halt(robot)
            get_logger(robot=robot).warning("halted: the browser that steers it fell silent")
            hold.on_trouble(robot, StaleCommandError(f"halted after {SILENCE_S:g} s of silence", robot=robot))


def _tell_unhalted(robot: str, halted: Future[int]) -> None:
    error = halted.exception()
    if error is not None:
        get_logger(robot=robot).error("could not be halted after steering", reason=str(error))
