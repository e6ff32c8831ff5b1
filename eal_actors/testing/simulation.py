"""A simulated fleet whose time a test moves."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import unknown_name
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import ArgumentError, UnavailableError, WaitTimeoutError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import Report, Scenario, run_scenario
from eal_actors.testing.making import Robots, World, simulated_fleet
from eal_actors.testing.scenario_text import read_scenario


class Pose(NamedTuple):
    """Where a robot truly is, in the world's frame: origin in the middle of the floor, x right, y up."""

    x_m: float
    y_m: float
    yaw_rad: float
    """In (-pi, pi], counter-clockwise from the x axis."""

    def __str__(self) -> str:
        return f"x {self.x_m:.3f} m, y {self.y_m:.3f} m, yaw {math.degrees(self.yaw_rad):.1f} deg"


class Simulation:
    """Simulated robots in a world, and time that stands still until the test moves it.

        with Simulation({"scout": "roomba", "mate": {"model": "evbot3", "start": (1.0, 0.0, 90)}}) as simulation:
            simulation["scout"]["Base"].send_cmd("f1")
            simulation.advance_until(lambda: simulation.is_bumping("scout"))

    Time goes on in `advance`, `advance_until` and `run`, and wherever the test waits for a robot, for as long as the
    answer takes. So the same test sees the same values whenever it is run.

    Args:
        robots: each robot's name to its model, or to the settings of the sim plugin, of which `start` may be
            (x_m, y_m) or (x_m, y_m, yaw_deg), and to what else a robot of a fleet file may have, such as `tags` and
            `plugins`. `{n}` in a name together with `count` makes several. Or the path of a fleet file.
        world: the name of a world that comes with the framework, such as "lab"; or a world file, a WorldModel, or what
            a world file would say. None is the fleet file's world, or "empty" where there is no fleet file.
        seed: where all randomness starts from; None is the fleet file's seed, or 0.
        plugin_dirs: folders of further plugins.

    Raises:
        ConfigError: everything that is wrong with the robots and the world.

    Thread: one; start controllers in other threads with `simulation.fleet.tasks`.
    """

    def __init__(
        self,
        robots: Robots,
        world: World | None = None,
        *,
        seed: int | None = None,
        plugin_dirs: Sequence[str | Path] = (),
    ) -> None:
        self._config = simulated_fleet(robots, world, seed, plugin_dirs)
        self._clock = _NotingClock()
        self._fleet: Fleet | None = None  # while it is open: whoever keeps a closed simulation keeps no world

    def __repr__(self) -> str:
        return f"<Simulation of {', '.join(self._config.robots)}: {'closed' if self._fleet is None else 'open'}>"

    # Opening and closing.

    def open(self) -> Self:
        """Connect the robots; harmless if they are connected. After a close it begins anew, at time 0.

        Raises:
            ConfigError: a plugin that does not exist, or settings that it refuses.
            PluginError: a robot lacks a plugin that did not connect, such as for a start that is not free.
            RobotFailedError: a robot could not start.
            UnavailableError: a robot did not start in time.
        """
        if self._fleet is None:
            self._clock = _NotingClock()
            fleet = Fleet(self._config, self._clock)
            try:
                _connect_all(fleet)
            except BaseException:
                fleet.close()
                raise
            self._fleet = fleet
        return self

    def close(self) -> None:
        """Halt and disconnect every robot. Calling it twice is harmless."""
        fleet, self._fleet = self._fleet, None
        if fleet is not None:
            fleet.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    # The fleet.

    @property
    def fleet(self) -> Fleet:
        """The connected fleet.

        Raises:
            UnavailableError: the simulation is not open.
        """
        if self._fleet is None:
            raise UnavailableError("the simulation is not open; use `with Simulation(...) as simulation:`")
        return self._fleet

    def __getitem__(self, robot: str) -> RobotHandle:
        """Return a robot.

        Raises:
            RobotNotFoundError: there is no robot of that name.
            UnavailableError: the simulation is not open.
        """
        return self.fleet[robot]

    @property
    def seed(self) -> int:
        """Where all randomness starts from."""
        return self._config.seed

    def threads_left(self, timeout_s: float) -> tuple[str, ...]:
        """Wait for the threads that live by the simulation's clock to end; return the names of those that go on.

        Args:
            timeout_s: real seconds to wait at most.

        Thread: blocks the caller.
        """
        end_s = REAL_TIME.now() + timeout_s
        with self._clock.outside():
            for thread in self._clock.started:
                thread.join(max(0.0, end_s - REAL_TIME.now()))
        return tuple(thread.name for thread in self._clock.started if thread.is_alive())

    # Time.

    @property
    def now_s(self) -> float:
        """Simulated seconds since the simulation was opened."""
        return self._clock.now()

    def advance(self, duration_s: float) -> None:
        """Let time go on: whatever robots do in these seconds is done when this returns.

        Args:
            duration_s: simulated seconds, at least 0.

        Raises:
            ArgumentError: the duration is under 0 or not finite.
            UnavailableError: the simulation is not open.
        """
        self.fleet.clock.sleep(_checked_s("duration_s", duration_s))

    def advance_until(
        self, condition: Callable[[], object], timeout_s: float = 60.0, *, every_s: float = 0.05
    ) -> float:
        """Let time go on until a condition holds.

        Args:
            condition: is asked at once and then every `every_s`; what is truthy holds.
            timeout_s: simulated seconds after which to give up.
            every_s: simulated seconds between two looks, over 0.

        Returns:
            The simulated seconds that it took.

        Raises:
            WaitTimeoutError: it does not hold by then; the message tells where the robots are.
            ArgumentError: a duration is under 0, 0 between two looks, or not finite.
            UnavailableError: the simulation is not open.
        """
        clock, start_s = self.fleet.clock, self.now_s
        end_s = start_s + _checked_s("timeout_s", timeout_s)
        if _checked_s("every_s", every_s) == 0:
            raise ArgumentError("every_s must be over 0, or time would stand still")
        while not condition():
            left_s = end_s - clock.now()
            if left_s <= 0:
                raise WaitTimeoutError(f"{_described(condition)} did not hold within {timeout_s:g} s; {self._places()}")
            clock.sleep(min(every_s, left_s))
        return clock.now() - start_s

    # What there is to assert on.

    def pose(self, robot: str) -> Pose:
        """Return where a robot truly is, by its resource Pose.

        Raises:
            RobotNotFoundError: there is no robot of that name.
            ResourceNotFoundError: it has no resource Pose.
            UnavailableError: the simulation is not open.
        """
        x_m, y_m, yaw_rad = map(float, self[robot]["Pose"].get_value().get().value)
        return Pose(x_m, y_m, yaw_rad)

    def distance_m(self, robot: str, other: str | tuple[float, float]) -> float:
        """Return the distance between the middles of two robots, or from a robot to a point.

        Args:
            robot: a robot's name.
            other: another robot's name, or x and y in metres.

        Raises:
            RobotNotFoundError: there is no robot of that name.
            ResourceNotFoundError: it has no resource Pose.
            UnavailableError: the simulation is not open.
        """
        x_m, y_m = self.pose(other)[:2] if isinstance(other, str) else other
        here = self.pose(robot)
        return math.hypot(here.x_m - x_m, here.y_m - y_m)

    def is_bumping(self, robot: str) -> bool:
        """Return whether something presses a robot's bumper, by its resource Bump.

        Raises:
            RobotNotFoundError: there is no robot of that name.
            ResourceNotFoundError: it has no resource Bump.
            UnavailableError: the simulation is not open.
        """
        return bool(self[robot]["Bump"].get_value().get().value)

    # What goes wrong on purpose.

    def inject(self, robot: str, **faults: bool | float | str | Sequence[str]) -> None:
        """Make something wrong with a robot, by its resource Faults, which says what there is.

            simulation.inject("scout", motor_left=0.5, frozen=["Range", "Camera"])

        Args:
            robot: its name.
            faults: what becomes wrong; what is not named stays as it is.

        Raises:
            ArgumentError: there is no such fault, or not with such a value.
            RobotNotFoundError: there is no robot of that name.
            ResourceNotFoundError: it has no resource Faults.
            UnavailableError: the simulation is not open.
        """
        resource = self[robot]["Faults"]
        known = [info.name for info in resource.info.configs]
        for name in faults:
            if name not in known:
                raise ArgumentError(unknown_name("fault", name, known), robot=robot)
        for name, value in faults.items():
            plain = value if isinstance(value, bool | int | float | str) else ",".join(value)
            resource.set_config(name, plain).get()

    def clear_faults(self, robot: str) -> None:
        """End all faults of a robot; what its fault plan still holds happens nevertheless.

        Raises:
            RobotNotFoundError: there is no robot of that name.
            ResourceNotFoundError: it has no resource Faults.
            UnavailableError: the simulation is not open.
        """
        self[robot]["Faults"].send_cmd("clear").get()

    # Scenarios.

    def run(self, scenario: str | Path | Scenario, *, directory: Path | None = None) -> Report:
        """Run a scenario from beginning to end.

        Args:
            scenario: a scenario, the path of its file, or its text, which has more than one line.
            directory: the run's folder for what it leaves behind; None keeps nothing.

        Raises:
            ConfigError: what is wrong with the scenario, or what the robots cannot do.
            ScenarioError: it saves files, and there is no directory.
            UnavailableError: the simulation is not open.
        """
        fleet = self.fleet
        loaded = scenario if isinstance(scenario, Scenario) else read_scenario(scenario)
        return run_scenario(loaded, fleet, directory=directory)

    def _places(self) -> str:
        places = [f"{name} is at {self.pose(name)}" for name, robot in self.fleet.items() if "Pose" in robot]
        return "; ".join([f"{self.now_s:g} s since the start", *places])


class _NotingClock(LockStepClock):
    """A clock that knows the threads that live by it."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[threading.Thread] = []

    def start(self, thread: threading.Thread) -> None:
        """See Clock."""
        self.started.append(thread)
        super().start(thread)


def _connect_all(fleet: Fleet) -> None:
    """Connect a fleet, and raise what keeps any of its robots from being there as a whole."""
    fleet.connect()
    for robot in fleet.values():
        robot.require_started()
    for problem in fleet.problems:
        raise problem


def _checked_s(name: str, duration_s: float) -> float:
    if not 0 <= duration_s < math.inf:
        raise ArgumentError(f"{name} must be at least 0 and finite, not {duration_s}")
    return duration_s


def _described(condition: Callable[[], object]) -> str:
    name = getattr(condition, "__name__", "<lambda>")
    return "the condition" if name == "<lambda>" else f"the condition {name}"
