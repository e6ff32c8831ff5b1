"""Robots that start together, however far away they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.synchronized_start import CommandBegin
from eal_actors.kernel.errors import (
    ArgumentError,
    DeadlineError,
    PreemptedError,
    RobotNotFoundError,
    StaleCommandError,
    StoppedError,
)
from tests.net.rig import WAIT_S, Rig, failure

NEAR_S = 0.15
"""Tolerance for a busy machine; the delay of the links below is far more."""
FAR_S = 0.3


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path, ("r1", "r2"))


def timed(fleet: Fleet, command: str, in_s: float, **options: Any) -> Call[int]:
    call = fleet["r1"]["Arm"].send_cmd(command, at_s=fleet.clock.now() + in_s, **options)
    assert isinstance(call, Call)
    return call


def test_robots_start_together_over_uneven_links(rig: Rig, fleet: Fleet) -> None:
    fleet.services.link("r2").impair(delay_s=FAR_S)
    arms = [robot["Arm"] for robot in fleet.values()]
    start = fleet.together({arms[0]: "step1", arms[1]: ("step2", None)})
    assert [future.get(timeout=WAIT_S) for future in start.futures] == [1, 2]
    record = start.record.get(timeout=WAIT_S)
    assert [(begin.robot, begin.resource, begin.command) for begin in record.begins] == [
        ("r1", "Arm", "step1"),
        ("r2", "Arm", "step2"),
    ]
    assert record.skew_s is not None
    assert record.skew_s < NEAR_S
    for begin in record.begins:
        assert begin.began_s is not None
        assert 0 < begin.error_s < NEAR_S
        assert begin.began_s == pytest.approx(start.start_s, abs=NEAR_S)
    times = [note.time_s for note in rig.notes("step")]
    seen_s = max(times) - min(times)
    assert abs(seen_s - record.skew_s) < record.skew_error_s + NEAR_S


def test_long_commands_tell_when_they_began(fleet: Fleet) -> None:
    start = fleet.together({robot["Arm"]: "move0.3" for robot in fleet.values()}, lead_s=0.2)
    assert [future.get(timeout=WAIT_S) for future in start.futures] == [7, 7]
    skew_s = start.record.get(timeout=WAIT_S).skew_s
    assert skew_s is not None
    assert skew_s < NEAR_S


def test_one_that_fails_leaves_the_others_alone(fleet: Fleet) -> None:
    arms = [robot["Arm"] for robot in fleet.values()]
    start = fleet.together({arms[0]: "step1", arms[1]: "dance"})
    failure(start.futures[1], ArgumentError)
    assert start.futures[0].get(timeout=WAIT_S) == 1
    record = start.record.get(timeout=WAIT_S)
    assert record.skew_s is None
    assert record.begins[0].began_s is not None
    assert record.begins[1].began_s is None


def test_the_rate_of_the_clocks_counts(tmp_path: Path) -> None:
    rig = Rig(tmp_path, extra={"clock": {"rate": 20}})
    with rig.served_here() as fleet:
        call = timed(fleet, "step1", 8.0)
        assert call.get(timeout=WAIT_S * 20) == 1
        assert call.start_s is not None
        assert call.began_s == pytest.approx(call.start_s, abs=NEAR_S * 20)
        assert fleet.clock.now() > call.start_s - NEAR_S * 20


def test_a_value_is_set_at_its_time(rig: Rig, fleet: Fleet) -> None:
    at_s = fleet.clock.now() + 0.3
    assert fleet["r1"]["Arm"].set_value(0.5, at_s=at_s).get(timeout=WAIT_S) == 1
    assert fleet.clock.now() > at_s - NEAR_S


@pytest.mark.parametrize(
    "do",
    [
        pytest.param(lambda robot: robot["Arm"].halt(), id="halt"),
        pytest.param(lambda robot: robot["Arm"].send_cmd("s"), id="urgent command"),
        pytest.param(lambda robot: robot.stop("test"), id="emergency stop"),
        pytest.param(lambda robot: robot["Arm"].send_cmd("step2"), id="newer command"),
    ],
)
def test_it_is_called_off_by(rig: Rig, fleet: Fleet, do: Callable[[RobotHandle], Future[Any]]) -> None:
    call = timed(fleet, "step1", 0.6)
    do(fleet["r1"]).get(timeout=WAIT_S)
    # A stop may overtake it on its way, so that the robot refuses it.
    assert isinstance(call.exception(timeout=WAIT_S), PreemptedError | StoppedError | StaleCommandError)
    fleet.clock.sleep(0.8)
    assert [note for note in rig.notes("step") if note.what == "1"] == []


def test_one_that_is_cancelled_does_not_begin(rig: Rig, fleet: Fleet) -> None:
    call = timed(fleet, "step1", 0.6)
    assert call.cancel()
    fleet.clock.sleep(0.8)
    assert rig.notes("step") == []


def test_a_start_beyond_the_deadline_is_refused(fleet: Fleet) -> None:
    assert "after its deadline" in failure(timed(fleet, "step1", 3.0, timeout_s=2.0), DeadlineError).message
    assert fleet.clock.now() < WAIT_S


def test_what_is_not_of_this_fleet(fleet: Fleet, tmp_path: Path) -> None:
    other = Rig(tmp_path, ("r7",))
    with Fleet(other.local()) as strangers, pytest.raises(RobotNotFoundError, match="r7"):
        fleet.together({strangers["r7"]["Arm"]: "step1"})
    with pytest.raises(ArgumentError, match="lead_s must be seconds, at least 0, not -1"):
        fleet.together({}, lead_s=-1)
    assert fleet.together({}).record.get().begins == ()


def test_within_a_process_at_rate_max_the_start_is_exact(rig: Rig) -> None:
    with Fleet(replace(rig.local(), rate="max")) as fleet:
        fleet.services.link("r2").impair(delay_s=FAR_S)
        start = fleet.together({robot["Arm"]: f"step{n}" for n, robot in enumerate(fleet.values())}, lead_s=0.5)
        record = start.record.get()
        assert start.start_s == 0.5 + FAR_S
        assert record.begins == tuple(
            CommandBegin(f"r{n + 1}", "Arm", f"step{n}", start.start_s, 0.0) for n in range(2)
        )
        assert (record.skew_s, record.skew_error_s) == (0.0, 0.0)
