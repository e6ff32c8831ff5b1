from __future__ import annotations

import math

import pytest

from eal_actors.device.motion.closed_loop import PATIENCE_S
from eal_actors.facade.traffic.plan_run import SILENCE_S
from eal_actors.facade.traffic.positions import RobotPositions
from eal_actors.facade.traffic.trips import Journey
from eal_actors.kernel.errors import (
    ArgumentError,
    BlockedError,
    CallCancelledError,
    DeadlineError,
    EALError,
    NotReadyError,
    PlaceNotFoundError,
    PreemptedError,
    ResourceNotFoundError,
    RobotNotFoundError,
)
from eal_actors.testing import Simulation
from tests.motion.rig import tracked
from tests.traffic.rig import Mishaps, TravelWatch, floor, swap, travelling

PERSON = {"kind": "circle", "x_m": 0.0, "y_m": 0.0, "radius_m": 0.2}
TWO = {"a": ("evbot3", (-1.0, 0.0)), "b": ("evbot2", (1.0, 0.0))}


def error_of(journey: Journey, robot: str) -> BaseException | None:
    return journey.arrivals[robot].exception()


@pytest.mark.parametrize("seed", range(1))
def test_robots_swap_places_with_stops_and_a_loss(seed: int) -> None:
    """The short form of `make bench-go`: six robots of three makes, some slow, some stopped, one killed."""
    starts, goals, world = swap(6, seed)
    with travelling(starts, world, seed) as watch:
        mishaps = Mishaps(watch, seed)
        journey = watch.simulation.fleet.go_to(goals)

        def is_over() -> bool:
            mishaps.happen()
            return journey.done()

        watch.until(is_over, 400.0)
        assert watch.least_gap_m > 0, f"seed {seed}"
        for name, arrival in journey.arrivals.items():
            if name != mishaps.killed:
                assert arrival.exception() is None, f"seed {seed}"
                assert watch.distance_m(name, goals[name]) < 0.02, f"seed {seed}"


def test_two_robots_swap_in_any_heading_and_the_result_names_them() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        journey = watch.simulation.fleet.go_to({"a": (1.0, 0.0, 90), "b": (-1.0, 0.0, -90)})
        assert watch.until_done(journey) is None
        assert journey.get() == {"a": 1, "b": 1}
        assert watch.least_gap_m > 0
        assert watch.distance_m("a", (1.0, 0.0)) < 0.015
        assert abs(math.remainder(watch.pose("b")[2] + math.pi / 2, math.tau)) < math.radians(3)


def test_a_run_repeats() -> None:
    trails = []
    for _ in range(2):
        with travelling(TWO, floor(4, 4), 7) as watch:
            assert watch.until_done(watch.simulation.fleet.go_to({"a": (1.0, 0.0), "b": (-1.0, 0.0)})) is None
            trails.append(watch.trail)
    assert trails[0] == trails[1]


def test_names_of_places_and_of_nothing() -> None:
    places = {"dock": {"x_m": 0.5, "y_m": 0.5, "yaw_deg": 90}}
    with travelling(TWO, floor(4, 4, places=places), 1) as watch:
        fleet = watch.simulation.fleet
        assert watch.until_done(fleet.go_to({fleet["a"]: "dock"})) is None
        assert watch.distance_m("a", (0.5, 0.5)) < 0.015
        with pytest.raises(PlaceNotFoundError, match="did you mean 'dock'"):
            fleet.go_to({"a": "dok"})
        with pytest.raises(RobotNotFoundError):
            fleet.go_to({"z": "dock"})
        with pytest.raises(ArgumentError, match="twice"):
            fleet.go_to({"a": "dock", fleet["a"]: "dock"})
        with pytest.raises(ArgumentError, match="the goal of a must be"):
            fleet.go_to({"a": (1.0, float("nan"))})
        with pytest.raises(ArgumentError, match="timeout_s"):
            fleet.go_to({"a": "dock"}, timeout_s=0)
        assert fleet.go_to({}).get() == {}


def test_a_robot_without_a_base_cannot_go() -> None:
    with Simulation({"a": {"plugins": {"sample": {}}}}) as simulation, pytest.raises(ResourceNotFoundError):
        simulation.fleet.go_to({"a": (0.0, 0.0)})


@pytest.mark.parametrize(
    ("goals", "message"),
    [
        ({"a": (0.0, 1.0), "b": (0.0, 1.1)}, "b.* is 0.10 m from the goal of a"),
        ({"a": (0.0, 0.0), "b": (0.0, 1.0)}, "the goal of a, .*is inside an obstacle"),
        ({"a": (0.0, 1.0), "b": (9.0, 1.0)}, "the goal of b, .* is outside the map"),
    ],
)
def test_nobody_moves_where_there_is_no_plan(goals: dict[str, tuple[float, float]], message: str) -> None:
    with travelling(TWO, floor(4, 4, PERSON), 1) as watch:
        journey = watch.simulation.fleet.go_to(goals)
        with pytest.raises(ArgumentError, match=message):
            journey.get()
        assert all(arrival.exception() is not None for arrival in journey.arrivals.values())
        assert watch.distance_m("a", (-1.0, 0.0)) < 0.001
        assert watch.distance_m("b", (1.0, 0.0)) < 0.001


def test_a_robot_drives_round_a_robot_that_is_not_sent() -> None:
    with travelling({"a": ("roomba", (-1.2, 0.0)), "b": ("evbot2", (0.0, 0.0))}, floor(4, 4), 1) as watch:
        assert watch.until_done(watch.simulation.fleet.go_to({"a": (1.2, 0.0)})) is None
        assert watch.distance_m("b", (0.0, 0.0)) < 0.001
        assert watch.least_gap_m > 0.05


@pytest.mark.parametrize(("width_m", "arrives"), [(3.0, True), (0.9, False)])
def test_somebody_stands_in_the_way_for_ever(width_m: float, arrives: bool) -> None:
    """The robot finds another way, or says what blocks it. The fleet does not know that the other one was carried."""
    starts = {"a": ("evbot3", (-1.9, 0.0)), "person": ("evbot2", (2.6, 0.0))}
    with travelling(starts, floor(6, width_m), 1) as watch:
        watch.untracked.add("person")
        journey = watch.simulation.fleet.go_to({"a": (1.7, 0.0)})
        watch.until(lambda: watch.distance_m("a", (-1.9, 0.0)) > 0.2)
        watch.simulation["person"]["TruePose"].set_value([0.3, 0.0, 0.0]).get()
        error = watch.until_done(journey)
        assert watch.least_gap_m > 0
        if arrives:
            assert error is None
            assert watch.distance_m("a", (1.7, 0.0)) < 0.015
        else:
            assert isinstance(error, BlockedError)
            assert "something is" in str(error)
            assert error.robot == "a"
            before = watch.pose("a")
            watch.simulation.advance(2.0)
            assert watch.pose("a") == before


def test_a_cancelled_journey_stops_its_robots() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        journey = watch.simulation.fleet.go_to({"a": (1.0, 0.0), "b": (-1.0, 0.0)})
        watch.until(lambda: watch.distance_m("a", (-1.0, 0.0)) > 0.2)
        journey.cancel()
        watch.simulation.advance(1.0)
        before = [watch.pose(name) for name in TWO]
        watch.simulation.advance(5.0)
        assert [watch.pose(name) for name in TWO] == before
        assert isinstance(error_of(journey, "a"), CallCancelledError)


@pytest.mark.parametrize("call", ["halt", "stop"])
def test_a_halt_of_the_fleet_ends_all_trips(call: str) -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        fleet = watch.simulation.fleet
        journey = fleet.go_to({"a": (1.0, 0.0), "b": (-1.0, 0.0)})
        watch.until(lambda: watch.distance_m("a", (-1.0, 0.0)) > 0.2)
        getattr(fleet, call)().get()
        watch.simulation.advance(1.0)
        before = [watch.pose(name) for name in TWO]
        watch.simulation.advance(5.0)
        assert [watch.pose(name) for name in TWO] == before
        assert isinstance(journey.exception(), EALError)
        fleet.resume().get()


def test_a_robot_that_somebody_else_commands_leaves_the_journey_and_the_other_drives_round_it() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        journey = watch.simulation.fleet.go_to({"a": (1.0, 0.0), "b": (-1.0, 0.0)})
        watch.until(lambda: watch.distance_m("b", (1.0, 0.0)) > 0.9)
        watch.simulation["b"].base.stop()
        watch.until_done(journey)
        assert isinstance(error_of(journey, "b"), PreemptedError)
        assert error_of(journey, "a") is None
        assert watch.distance_m("a", (1.0, 0.0)) < 0.015
        assert watch.least_gap_m > 0


def test_a_newer_go_to_replaces_the_trips_of_its_robots_alone() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        fleet = watch.simulation.fleet
        first = fleet.go_to({"a": (1.0, 0.0), "b": (-1.0, 0.0)})
        watch.until(lambda: watch.distance_m("a", (-1.0, 0.0)) > 0.2)
        second = fleet.go_to({"a": (0.0, 1.2)})
        assert watch.until_done(second) is None
        watch.until_done(first)
        assert isinstance(error_of(first, "a"), PreemptedError)
        assert error_of(first, "b") is None
        assert watch.distance_m("a", (0.0, 1.2)) < 0.015
        assert watch.distance_m("b", (-1.0, 0.0)) < 0.015
        assert watch.least_gap_m > 0


def test_a_journey_has_a_deadline() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        journey = watch.simulation.fleet.go_to({"a": (1.0, 1.0)}, timeout_s=2.0)
        with pytest.raises(DeadlineError, match=r"a: go_to \(1, 1\)"):
            journey.get()
        watch.simulation.advance(1.0)
        before = watch.pose("a")
        watch.simulation.advance(3.0)
        assert watch.pose("a") == before


def test_a_closed_fleet_leaves_no_trip_behind() -> None:
    simulation = Simulation({"a": {"model": "roomba", "start": (0.0, 0.0)}}, floor(4, 4), seed=1).open()
    journey = simulation.fleet.go_to({"a": (1.0, 0.0)})
    simulation.advance(1.0)
    simulation.close()
    assert isinstance(journey.exception(), EALError)
    assert simulation.threads_left(10.0) == ()


def test_a_robot_that_comes_nearer_between_its_stops_is_not_given_up() -> None:
    """Its motors fail four times in half a metre of a corridor, each time for longer than it waits."""
    with travelling({"a": ("evbot3", (-1.9, 0.0))}, floor(6, 0.9), 1) as watch:
        journey = watch.simulation.fleet.go_to({"a": (1.7, 0.0)})
        for x_m in (-1.38, -1.28, -1.18, -1.08):
            watch.until(lambda x_m=x_m: watch.pose("a")[0] > x_m or journey.done())  # type: ignore[misc]
            fail_motors(watch, "a", 5.6)
        assert watch.until_done(journey) is None
        assert watch.distance_m("a", (1.7, 0.0)) < 0.015


def test_a_robot_that_is_held_near_its_goal_disturbs_nobody_and_goes_on() -> None:
    """Its motors fail for 25 s: nothing is closed to the others, and no other way would lead to its goal."""
    with travelling(TWO, floor(4, 4), 1) as watch:
        journey = watch.simulation.fleet.go_to({"a": (0.0, 0.0), "b": (1.0, 1.2)})
        watch.until(lambda: watch.distance_m("a", (0.0, 0.0)) < 0.05)
        fail_motors(watch, "a", 25.0)
        assert watch.until_done(journey) is None
        assert watch.distance_m("a", (0.0, 0.0)) < 0.015


def fail_motors(watch: TravelWatch, name: str, duration_s: float) -> None:
    watch.simulation.inject(name, motor_left=0.0, motor_right=0.0)
    end_s = watch.simulation.now_s + duration_s
    watch.until(lambda: watch.simulation.now_s >= end_s)
    watch.simulation.inject(name, motor_left=1.0, motor_right=1.0)


@pytest.mark.parametrize(
    ("silent_s", "arrives"), [(PATIENCE_S + 5.0, True), pytest.param(40.0, False, marks=pytest.mark.slow)]
)
def test_a_base_that_answers_again_within_15_s_is_sent_on(silent_s: float, arrives: bool) -> None:
    """A driver at an emulated base: its own loop gives up after 5 s, and the traffic control tries it again."""
    with tracked("evbot3", 0) as it:
        it.fix()
        journey = it.simulation.fleet.go_to({"robot": (1.5, 0.0)})
        it.until_moving(journey)
        it.simulation.inject("body", dead=True)
        begun_s = it.simulation.now_s
        while it.simulation.now_s < begun_s + silent_s and not journey.done():
            it.simulation.advance(0.1)
        if arrives:
            assert it.robot["Base"].send_cmd("goto", [1.5, 0.0]).exception() is not None, "it is silent still"
            it.simulation.clear_faults("body")
            it.simulation.advance(0.5)
            assert it.until_done(journey) is None
            assert it.errors(1.5, 0.0, None)[0] < 0.02
        else:
            assert isinstance(journey.exception(), NotReadyError)
            assert SILENCE_S <= it.simulation.now_s - begun_s < SILENCE_S + PATIENCE_S + 3.0
            assert it.robot.not_ready


def test_of_two_requests_of_one_moment_the_newer_counts() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        fleet = watch.simulation.fleet
        first, second = fleet.go_to({"a": (0.0, 1.2)}), fleet.go_to({"a": (-1.0, 1.0)})
        assert watch.until_done(second) is None
        assert first.done()
        assert isinstance(error_of(first, "a"), PreemptedError)


def test_a_robot_that_left_the_fleet_is_no_obstacle() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        fleet = watch.simulation.fleet
        robots = dict(fleet)
        positions = RobotPositions(robots)
        positions.read((), fleet.clock)
        del robots["b"]
        positions.read((), fleet.clock)
        assert list(positions.places) == ["a"]
