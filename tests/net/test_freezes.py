"""Robots whose processes freeze for a while refuse stale commands and halt."""

from __future__ import annotations

from pathlib import Path

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import (
    DeadlineError,
    PreemptedError,
    StaleCommandError,
    StoppedError,
    UnavailableError,
)
from tests.net.links import eventually
from tests.net.rig import LONGER_THAN_TTL_S, WAIT_S, Rig, becomes, failure, outlast_ttl, ready, served

LONG_LEASE = {"lease_s": 20.0, "dead_man_s": 20.0}


def test_a_freeze_inside_the_lease_makes_commands_stale(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network=LONG_LEASE)
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        assert robot["Arm"].send_cmd("step0").get() == 0
        running["r1"].freeze()
        old = [robot["Arm"].send_cmd(f"step{n}") for n in (1, 2)]
        status = robot["Gauge"].get_status()
        outlast_ttl(robot)
        running["r1"].thaw()
        for call in old:
            assert "may be 1.000 s old at most" in str(failure(call, StaleCommandError))
        assert status.get() == 3  # readings do no harm
        assert robot.state is RobotState.READY
        assert robot["Arm"].send_cmd("step3").get() == 3
    assert rig.steps() == ["0", "3"]


def test_a_short_freeze_harms_nobody(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network=LONG_LEASE)
    with served(rig) as (running, fleet):
        running["r1"].freeze()
        calls = [fleet["r1"]["Arm"].send_cmd(f"step{n}") for n in range(3)]
        failure(fleet["r1"]["Gauge"].get_value(timeout_s=0.1), DeadlineError)
        running["r1"].thaw()
        errors = [call.exception(timeout=WAIT_S) for call in calls]
        assert all(error is None or isinstance(error, StaleCommandError) for error in errors), errors
        assert rig.steps() == [str(n) for n, error in enumerate(errors) if error is None]


def test_a_halt_is_obeyed_however_old(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network=LONG_LEASE)
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        move = robot["Arm"].send_cmd("move60")
        assert rig.begun("move60")
        running["r1"].freeze()
        halt, stop = robot["Arm"].halt(), robot["Arm"].send_cmd("s")
        outlast_ttl(robot)
        running["r1"].thaw()
        assert halt.get() == 1
        assert stop.get() == 1
        failure(move, PreemptedError)
    assert rig.notes("halt")
    assert rig.notes("stop")
    assert not rig.notes("end")


def test_a_freeze_beyond_the_dead_mans_time_halts_at_the_waking(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network={"lease_s": 20.0, "dead_man_s": 0.5})
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        move = robot["Arm"].send_cmd("move60")
        assert rig.begun("move60")
        running["r1"].freeze()
        outlast_ttl(robot)
        assert not rig.notes("halt")
        running["r1"].thaw()
        assert "r1/Arm: halted: no heartbeat of its controller for 0.5 s" in str(failure(move, PreemptedError))
        assert eventually(lambda: bool(rig.notes("halt")))  # the answer may be here before the robot has halted
        assert robot["Arm"].send_cmd("step1").get() == 1
    assert not rig.notes("end")


def test_a_freeze_beyond_the_lease_loses_the_robot_and_its_commands(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network={"lease_s": 0.5, "dead_man_s": 10.0})
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        assert robot["Arm"].send_cmd("step0").get() == 0
        clock = SystemClock()
        running["r1"].freeze()
        old = [robot["Arm"].send_cmd(f"step{n}") for n in (1, 2)]
        assert becomes(robot, RobotState.LOST)
        lost_s = clock.now()
        failure(robot["Arm"].send_cmd("step3"), UnavailableError)
        clock.sleep(LONGER_THAN_TTL_S)  # younger commands may still run
        running["r1"].thaw()
        assert becomes(robot, RobotState.READY)
        for call in old:
            assert isinstance(call.exception(timeout=WAIT_S), StaleCommandError | UnavailableError)
        assert robot["Arm"].send_cmd("step4").get() == 4
    assert lost_s < 6.0  # lease + 0.5 s on an idle machine
    assert rig.steps() == ["0", "4"]


def test_a_running_command_is_followed_again_after_a_freeze(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network={"lease_s": 0.5, "dead_man_s": 20.0})
    with served(rig) as (running, fleet):
        move = fleet["r1"]["Arm"].send_cmd("move3")
        assert rig.begun("move3")
        running["r1"].freeze()
        assert becomes(fleet["r1"], RobotState.LOST)
        assert not move.done()
        running["r1"].thaw()
        assert move.get() == 7
        assert fleet["r1"].state is RobotState.READY
    assert len(rig.notes("begin")) == len(rig.notes("end")) == 1


def test_an_emergency_stop_reaches_a_robot_that_was_out_of_reach(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network={"lease_s": 0.5, "dead_man_s": 20.0})
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        running["r1"].freeze()
        assert becomes(robot, RobotState.LOST)
        stop = fleet.stop("nobody moves")
        failure(stop, UnavailableError)
        running["r1"].thaw()
        assert becomes(robot, RobotState.READY)
        failure(robot["Arm"].send_cmd("step1"), StoppedError)
        with ready(Fleet(rig.config)) as other:
            assert eventually(lambda: other["r1"].stopped_because == "nobody moves")
        fleet.resume().get()
        assert robot["Arm"].send_cmd("step2").get() == 2
    assert rig.steps() == ["2"]
