"""Simulated fleet whose time the test advances, and the factory of a test's simulations."""

from __future__ import annotations

import math
import textwrap
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple, Self

from typing_extensions import override

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import unknown_name
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import ArgumentError, UnavailableError, WaitTimeoutError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import Report, Scenario, load_scenario, parse_scenario, run_scenario
from eal_actors.testing.fleet_config import Robots, World, simulated_fleet

_GRACE_S: Final = 2.0  # real seconds that threads have to end after their simulation is closed


class Pose(NamedTuple):
    """True pose of a robot in the map frame: origin at the centre of the floor, x to the right, y up."""

    x_m: float
    y_m: float
    yaw_rad: float
    """In (-pi, pi], counter-clockwise from the x axis."""

    def __str__(self) -> str:
        return f"x {self.x_m:.3f} m, y {self.y_m:.3f} m, yaw {math.degrees(self.yaw_rad):.1f} deg"


class Simulation:
    """Simulated robots in a world, with time that stands still until the test advances it.

        with Simulation({"scout": "roomba", "mate": {"model": "evbot3", "start": (1.0, 0.0, 90)}}) as simulation:
            simulation["scout"]["Base"].send_cmd("f1")
            simulation.advance_until(lambda: simulation.is_bumping("scout"))

    Time advances in `advance`, `advance_until` and `run`, and while the test waits for a robot's answer. So a test
    sees the same values in every run. Its methods raise UnavailableError while the simulation is not open,
    RobotNotFoundError for an unknown robot, and ResourceNotFoundError for a robot without the resource that they name.

    Args:
        robots: maps each robot's name to its model, or to settings of the simulation's plugin (`start` may be
            (x_m, y_m) or (x_m, y_m, yaw_deg)) and other keys of a robot in a fleet file, such as `tags` and `plugins`.
            `{n}` in a name together with `count` makes several robots. Or the path of a fleet file.
        world: name of a bundled world, such as "lab"; or a world file, a WorldModel, or the content of a world file.
            None is the fleet file's world, or "empty" without a fleet file.
        seed: seed of all randomness; None is the fleet file's seed, or 0.

    Raises:
        ConfigError: the robots or the world are wrong; names every problem.

    Thread: use it from one thread; `simulation.fleet.tasks` starts controllers in other threads.
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
        self._clock = _TrackingClock()
        self._fleet: Fleet | None = None  # only while open: a closed simulation keeps no world in memory

    def __repr__(self) -> str:
        return f"<Simulation of {', '.join(self._config.robots)}: {'closed' if self._fleet is None else 'open'}>"

    # Opening and closing.

    def open(self) -> Self:
        """Connect the robots; do nothing if they are connected. After a close, time starts again at 0.

        Raises:
            ConfigError: a plugin does not exist, or refuses its settings.
            PluginError: a plugin did not connect, for example because its start is occupied.
            RobotFailedError: a robot could not start.
            UnavailableError: a robot did not start in time.
        """
        if self._fleet is None:
            self._clock = _TrackingClock()
            fleet = Fleet(self._config, self._clock)
            try:
                for robot in fleet.connect().values():
                    robot.require_started()
                for problem in fleet.problems:
                    raise problem
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

    def __exit__(self, *_exc_info: object) -> None:
        self.close()

    # The fleet.

    @property
    def fleet(self) -> Fleet:
        """The connected fleet."""
        if self._fleet is None:
            raise UnavailableError("the simulation is not open; use `with Simulation(...) as simulation:`")
        return self._fleet

    def __getitem__(self, robot: str) -> RobotHandle:
        """Return a robot."""
        return self.fleet[robot]

    @property
    def seed(self) -> int:
        """Seed of all randomness."""
        return self._config.seed

    def threads_left(self, timeout_s: float) -> tuple[str, ...]:
        """Wait until the threads on the simulation's clock have ended; return the names of those that still run.

        It waits `timeout_s` real seconds at most.

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
        """Advance time by simulated seconds; return when the robots have done everything that they do in this time.

        Raises ArgumentError if the duration is under 0 or not finite.
        """
        self.fleet.clock.sleep(_require_duration("duration_s", duration_s))

    def advance_until(
        self, condition: Callable[[], object], timeout_s: float = 60.0, *, every_s: float = 0.05
    ) -> float:
        """Advance time until a condition is true.

        Args:
            condition: called at once and then every `every_s`.
            timeout_s: time limit, in simulated seconds.
            every_s: polling period in simulated seconds, over 0.

        Returns:
            The elapsed simulated seconds.

        Raises:
            WaitTimeoutError: the condition is still false at the time limit; the message has the robots' poses.
            ArgumentError: a duration is negative or not finite, or the period is 0.
        """
        clock, start_s = self.fleet.clock, self.now_s
        end_s = start_s + _require_duration("timeout_s", timeout_s)
        if _require_duration("every_s", every_s) == 0:
            raise ArgumentError("every_s must be over 0")
        while not condition():
            left_s = end_s - clock.now()
            if left_s <= 0:
                raise WaitTimeoutError(
                    f"{_name_condition(condition)} was not met within {timeout_s:g} s; {self._format_poses()}"
                )
            clock.sleep(min(every_s, left_s))
        return clock.now() - start_s

    # Assertions.

    def pose(self, robot: str) -> Pose:
        """Return the true pose of a robot, from its resource TruePose."""
        x_m, y_m, yaw_rad = map(float, self[robot]["TruePose"].get_value().get().value)
        return Pose(x_m, y_m, yaw_rad)

    def distance_m(self, robot: str, other: str | tuple[float, float]) -> float:
        """Return the distance between the centres of two robots, or from a robot to a point, x and y in metres."""
        x_m, y_m = self.pose(other)[:2] if isinstance(other, str) else other
        here = self.pose(robot)
        return math.hypot(here.x_m - x_m, here.y_m - y_m)

    def is_bumping(self, robot: str) -> bool:
        """Return whether a robot's bumper is pressed, from its resource Bump."""
        return bool(self[robot]["Bump"].get_value().get().value)

    # Faults.

    def inject(self, robot: str, **faults: bool | float | str | Sequence[str]) -> None:
        """Inject faults into a robot through its resource Faults, which lists them; other faults stay unchanged.

            simulation.inject("scout", motor_left=0.5, frozen=["Range", "Camera"])

        Raises:
            ArgumentError: the fault does not exist, or the value is not valid for it.
        """
        resource = self[robot]["Faults"]
        known = [info.name for info in resource.info.configs]
        for name in faults:
            if name not in known:
                raise ArgumentError(unknown_name("fault", name, known), robot=robot)
        for name, value in faults.items():
            scalar = value if isinstance(value, bool | int | float | str) else ",".join(value)
            resource.set_config(name, scalar).get()

    def clear_faults(self, robot: str) -> None:
        """End all faults of a robot; its fault plan continues."""
        self[robot]["Faults"].send_cmd("clear").get()

    # Scenarios.

    def run(self, scenario: str | Path | Scenario, *, directory: Path | None = None) -> Report:
        """Run a scenario to its end.

        Args:
            scenario: a scenario, the path of its file, or its text of more than one line.
            directory: the run's folder; None keeps no files.

        Raises:
            ConfigError: the scenario is wrong, or the robots cannot perform it.
            ScenarioError: the scenario saves files, and there is no directory.
        """
        fleet = self.fleet
        loaded = scenario if isinstance(scenario, Scenario) else read_scenario(scenario)
        return run_scenario(loaded, fleet, directory=directory)

    def _format_poses(self) -> str:
        places = [f"{name} is at {self.pose(name)}" for name, robot in self.fleet.items() if "TruePose" in robot]
        return "; ".join([f"{self.now_s:g} s since the start", *places])


class _TrackingClock(LockStepClock):
    """A clock that records the threads started on it."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[threading.Thread] = []

    @override
    def start(self, thread: threading.Thread) -> None:
        self.started.append(thread)
        super().start(thread)


def _require_duration(name: str, duration_s: float) -> float:
    if not 0 <= duration_s < math.inf:
        raise ArgumentError(f"{name} must be at least 0 and finite, not {duration_s}")
    return duration_s


def _name_condition(condition: Callable[[], object]) -> str:
    name = getattr(condition, "__name__", "<lambda>")
    return "the condition" if name == "<lambda>" else f"the condition {name}"


def read_scenario(source: str | Path) -> Scenario:
    """Read a scenario from its text of several lines, or from its file; raise ConfigError with all of its problems."""
    if isinstance(source, Path) or "\n" not in source:
        return load_scenario(source)
    return parse_scenario(textwrap.dedent(source), "scenario")


class SimulationFactory:
    """The value of the fixture `simulation`: a callable with the arguments of `Simulation` that returns an open one.

    Without a seed, simulations keep their own.
    """

    def __init__(self, seed: int | None = None) -> None:
        self._seed = seed
        self._made: list[Simulation] = []

    def __call__(
        self,
        robots: Robots,
        world: World | None = None,
        *,
        seed: int | None = None,
        plugin_dirs: Sequence[str | Path] = (),
    ) -> Simulation:
        """Return a new connected simulation; arguments and errors as for `Simulation` and its `open`."""
        chosen = self._seed if seed is None else seed
        simulation = Simulation(robots, world, seed=chosen, plugin_dirs=plugin_dirs)
        self._made.append(simulation)
        return simulation.open()

    def describe(self) -> str:
        """Return a line for each simulation, with the seed that repeats a failed test."""
        return "\n".join(f"{made!r}, {made.now_s:g} s since the start, --eal-seed={made.seed}" for made in self._made)

    def close(self) -> tuple[str, ...]:
        """Close every simulation; return the names of threads that still run. Thread: blocks the caller."""
        for simulation in self._made:
            simulation.close()
        end_s = REAL_TIME.now() + _GRACE_S
        left = [simulation.threads_left(max(0.0, end_s - REAL_TIME.now())) for simulation in self._made]
        return tuple(name for names in left for name in names)
