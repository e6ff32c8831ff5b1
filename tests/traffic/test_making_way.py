"""Robots that stand leave a place to others where nothing else helps."""

from __future__ import annotations

import math
from typing import Any

import pytest

from eal_actors.actors.future import Future
from eal_actors.kernel.errors import ArgumentError, BlockedError, DeadlineError
from tests.traffic.rig import TravelWatch, floor, travelling

TWO = {"a": ("evbot3", (-1.0, 0.0)), "b": ("evbot2", (1.0, 0.0))}


def corridor() -> dict[str, Any]:
    """Return a corridor of 0.9 m by 6 m, with a bay beside x = -0.9 m."""
    walls = (0.0, -0.825, 6.0), (-2.2, 0.825, 1.6), (1.3, 0.825, 3.4)
    boxes = [{"kind": "box", "x_m": x_m, "y_m": y_m, "size_m": [long_m, 0.75]} for x_m, y_m, long_m in walls]
    return floor(6, 2.4, *boxes)


def gone_from(watch: TravelWatch, name: str, place: tuple[float, float]) -> float:
    return math.dist(watch.pose(name)[:2], place)


def test_a_robot_that_was_not_sent_leaves_a_goal() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        assert watch.until_done(watch.simulation.fleet.go_to({"a": (0.9, 0.1)})) is None
        assert watch.distance_m("a", (0.9, 0.1)) < 0.015
        assert 0.4 < gone_from(watch, "b", (1.0, 0.0)) < 1.5
        assert watch.least_gap_m > 0.05


@pytest.mark.parametrize("reason", ["stopped", "busy"])
def test_a_robot_that_must_not_move_is_an_obstacle(reason: str) -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        other = watch.simulation["b"]
        if reason == "stopped":
            other.stop("maintenance")
        else:
            other.base.set_velocity(0.0, 1.0)
        watch.tick()
        journey = watch.simulation.fleet.go_to({"a": (0.9, 0.1)})
        with pytest.raises(ArgumentError, match="is occupied: b is at"):
            journey.get()
        assert gone_from(watch, "b", (1.0, 0.0)) < 0.01
        assert watch.distance_m("a", (-1.0, 0.0)) < 0.001


def test_a_robot_that_gave_up_makes_way() -> None:
    """The way of a is closed by somebody on no map, for ever, just where b is to go."""
    starts = {"a": ("evbot3", (-1.7, 0.0)), "b": ("evbot2", (-2.5, 0.0)), "person": ("evbot2", (2.6, 0.0))}
    with travelling(starts, corridor(), 1) as watch:
        watch.untracked.add("person")
        journey = watch.simulation.fleet.go_to({"a": (1.7, 0.0), "b": (0.0, 0.0)})
        watch.until(lambda: watch.pose("a")[0] > -1.0)
        watch.simulation["person"]["TruePose"].set_value([0.6, 0.0, 0.0]).get()
        assert isinstance(watch.until_done(journey), BlockedError)
        assert journey.arrivals["b"].exception() is None
        assert watch.distance_m("b", (0.0, 0.0)) < 0.015
        assert watch.least_gap_m > 0


def test_a_robot_that_has_arrived_makes_way_and_returns() -> None:
    starts = {"a": ("evbot3", (0.4, 0.0)), "b": ("evbot2", (-2.2, 0.0)), "c": ("roomba", (1.7, 0.0))}
    with travelling(starts, corridor(), 1) as watch:
        fleet = watch.simulation.fleet
        first = fleet.go_to({"a": (0.5, 0.0), "c": (2.3, 0.0, 90)})
        watch.until(first.arrivals["a"].done)
        assert not first.done()
        second = fleet.go_to({"b": (1.4, 0.0)})
        away: list[float] = []

        def are_over() -> bool:
            away.append(watch.distance_m("a", (0.5, 0.0)))
            return first.done() and second.done()

        watch.until(are_over)
        assert max(away) > 0.5
        for journey, name, goal in ((first, "a", (0.5, 0.0)), (first, "c", (2.3, 0.0)), (second, "b", (1.4, 0.0))):
            outcome: Future[int] = journey.arrivals[name]
            assert outcome.get() == 1
            assert watch.distance_m(name, goal) < 0.02
        assert watch.least_gap_m > 0.05


def test_a_deadline_needs_nobody_who_waits() -> None:
    with travelling(TWO, floor(4, 4), 1) as watch:
        journey = watch.simulation.fleet.go_to({"a": (1.0, 1.0)}, timeout_s=2.0)
        watch.simulation.advance(4.0)
        before = watch.pose("a")
        watch.simulation.advance(2.0)
        assert watch.pose("a") == before
        assert isinstance(journey.exception(), DeadlineError)
