"""Robots whose processes are killed, frozen, flooded and lied to: errors of callers, and calls that still work."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import (
    BusyError,
    CallError,
    PreemptedError,
    StaleCommandError,
    StoppedError,
    UnavailableError,
    UnsupportedError,
)
from tests.log_lines import log_lines
from tests.net.links import Wire, eventually, free_port
from tests.net.rig import WAIT_S, Rig, becomes, failure, other_clock, outlast_ttl, process, ready, served, servers

CONTROLLER = """
import sys
from eal_actors import Fleet
with Fleet.load(sys.argv[1]) as fleet:
    moves = fleet["r1"]["Arm"].send_cmd(sys.argv[2])
    print("commanding", flush=True)
    print(repr(moves.exception()), flush=True)
"""


def controller_of(rig: Rig, command: str = "move60") -> Any:
    """Run a controller that commands the arm, in a process of its own."""
    return process(["-c", CONTROLLER, str(rig.file), command], rig.folder)


# Deaths.


def test_a_kill_in_the_middle_of_a_command(rig: Rig) -> None:
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        move = robot["Arm"].send_cmd("move60")
        assert rig.begun("move60")
        clock = SystemClock()
        running["r1"].kill()
        assert becomes(robot, RobotState.LOST)
        lost_s = clock.now()
        clock = SystemClock()
        failure(robot["Arm"].send_cmd("step1"), UnavailableError)
        failure(robot["Gauge"].get_value(), UnavailableError)
        refused_s = clock.now()
        running.start("r1")
        assert becomes(robot, RobotState.READY)
        failure(move, UnavailableError)  # the new server knows nothing of it
        assert robot["Arm"].send_cmd("step2").get() == 2
    assert lost_s < 2.0  # 0.5 s on an idle machine
    assert refused_s < 1.0
    assert rig.steps() == ["2"]
    assert len(rig.notes("begin")) == 1


def test_a_restart_between_commands_is_seen_and_got_over(rig: Rig) -> None:
    with served(rig) as (running, fleet):
        arm = fleet["r1"]["Arm"]
        for n in range(2):
            assert arm.send_cmd(f"step{n}").get() == n
            running["r1"].kill()
            assert becomes(fleet["r1"], RobotState.LOST)
            assert "is unreachable" in str(fleet["r1"].problems[0])
            running.start("r1")
            assert becomes(fleet["r1"], RobotState.READY)
            assert not fleet["r1"].problems
        assert arm.send_cmd("step2").get() == 2
    assert rig.steps() == ["0", "1", "2"]


@pytest.mark.parametrize("number", ["SIGTERM", "SIGINT"])
def test_a_server_that_is_told_to_stop_halts_and_says_so(rig: Rig, number: str) -> None:
    import signal

    with served(rig) as (running, fleet):
        move = fleet["r1"]["Arm"].send_cmd("move60")
        assert rig.begun("move60")
        clock = SystemClock()
        running["r1"].signal(signal.Signals[number])
        assert running["r1"].wait() == 0
        ended_s = clock.now()
        error = failure(move, CallError)
        told_s = clock.now()
        assert isinstance(error, PreemptedError | StoppedError | UnavailableError), repr(error)
    assert ended_s < 10.0  # 1 s on an idle machine
    assert told_s < 12.0
    assert rig.notes("halt")
    assert not rig.notes("end")


@pytest.mark.parametrize("way", ["killed", "frozen"])
def test_a_controller_that_falls_silent_is_halted_for(tmp_path: Path, way: str) -> None:
    rig = Rig(tmp_path, network={"dead_man_s": 1.0, "lease_s": 10.0})
    with served(rig) as (_, fleet), controller_of(rig) as controller:
        controller.wait_for("commanding")
        assert rig.begun("move60")
        outlast_dead_man(fleet["r1"])  # its heartbeats keep it moving
        assert not rig.notes("halt")
        clock = SystemClock()
        if way == "killed":
            controller.kill()
        else:
            controller.freeze()
        assert eventually(lambda: rig.notes("halt"))
        halted_s = clock.now()
        assert fleet["r1"]["Arm"].get_status().get() == 0
        assert eventually(lambda: fleet["r1"]["Arm"].send_cmd("step1").exception(timeout=WAIT_S) is None)
        if way == "frozen":
            controller.thaw()
            controller.wait_for("PreemptedError")
    assert halted_s < 4.0
    assert not rig.notes("end")
    assert len(rig.notes("begin")) == 1


def outlast_dead_man(robot: RobotHandle) -> None:
    """Wait longer than the dead-man's time, with a request that takes so long."""
    assert robot["Gauge"].send_req("slow1.6").get().value == 1.6


# Absences.


@pytest.mark.slow
def test_half_of_a_fleet_is_absent(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("r1", "r2", "r3", "r4"))
    with servers(rig, "r1", "r3") as running, Fleet(rig.config) as fleet:
        present, absent = [fleet["r1"], fleet["r3"]], [fleet["r2"], fleet["r4"]]
        assert [robot.state for robot in present] == [RobotState.READY] * 2
        assert [robot.state for robot in absent] == [RobotState.LOST] * 2
        assert [(problem.robot, type(problem)) for problem in fleet.problems] == [
            ("r2", UnavailableError),
            ("r4", UnavailableError),
        ]
        assert all("does not answer at tcp/127.0.0.1:" in problem.message for problem in fleet.problems)
        assert gather(robot["Arm"].send_cmd("step1") for robot in present).get() == [1, 1]
        with pytest.raises(UnavailableError, match="does not answer"):
            fleet["r2"]["Arm"]
        running.start("r2", "r4")
        for robot in absent:
            assert becomes(robot, RobotState.READY)
        assert gather(robot["Arm"].send_cmd("step2") for robot in fleet.values()).get() == [2] * 4
        assert not fleet.problems
    assert rig.never_twice()


def test_a_robot_that_is_late_is_reported_by_what_it_has_not_done(tmp_path: Path) -> None:
    fleet = Fleet(Rig(tmp_path, ("absent",)).config)
    try:
        with log_lines() as log:
            fleet.connect(timeout_s=0.2)
        late = next(json.loads(line) for line in log.getvalue().splitlines() if "robot is late" in line)
        assert (late["robot"], late["reason"]) == ("absent", "it did not answer within 0.2 s")
    finally:
        fleet.close()


def test_who_is_there_is_up_before_the_absent_are_given_up(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("absent", "r1"))
    with servers(rig, "r1"):
        fleet = Fleet(rig.config)
        try:
            with pytest.raises(UnavailableError, match="absent"):
                fleet.connect(timeout_s=0.0)["absent"].require_started()
            assert becomes(fleet["r1"], RobotState.READY)
            assert fleet["absent"].state is RobotState.STARTING
        finally:
            fleet.close()


# Links.


@contextmanager
def over_a_wire(rig: Rig) -> Iterator[tuple[Wire, Fleet]]:
    """Serve the robots, and connect to the first through a wire that can be cut."""
    with servers(rig):
        wire = Wire(int(rig.content["robots"]["r1"]["address"].rpartition(":")[2]))
        try:
            rig.content["robots"]["r1"]["address"] = f"tcp/127.0.0.1:{wire.port}"
            rig.write()
            with ready(Fleet(rig.config)) as fleet:
                yield wire, fleet
        finally:
            wire.close()


def test_a_reading_under_way_is_asked_again_when_the_link_comes_back(rig: Rig) -> None:
    with over_a_wire(rig) as (wire, fleet):
        gauge = fleet["r1"]["Gauge"]

        def is_answered_after_a_cut() -> bool:
            reading = gauge.send_req("slow0.3", timeout_s=WAIT_S)
            assert eventually(lambda: len(rig.notes("slow")) > asked)
            wire.cut()
            error = reading.exception(timeout=WAIT_S)
            assert error is None or isinstance(error, UnavailableError), repr(error)
            assert becomes(fleet["r1"], RobotState.READY)
            return error is None

        for _ in range(10):  # on a busy machine the link may return after the wait
            asked = len(rig.notes("slow"))
            if is_answered_after_a_cut():
                break
        else:
            raise AssertionError("no reading was asked again")
        assert len(rig.notes("slow")) > asked + 1


def test_a_request_in_free_text_is_asked_once_and_its_answer_comes_after_the_cut(rig: Rig) -> None:
    """It was asked again, as a reading is: a service of ROS 2 was called twice."""
    with over_a_wire(rig) as (wire, fleet):
        request = fleet["r1"]["Line"].send_req("wait0.3", timeout_s=WAIT_S)
        assert eventually(lambda: rig.notes("asked"))
        wire.cut()
        assert request.get(timeout=WAIT_S).value == "wait0.3"
        assert len(rig.notes("asked")) == 1


# Floods.


def test_a_flood_leaves_the_server_as_small_as_it_was(rig: Rig) -> None:
    with served(rig) as (running, fleet):
        gauge, load = fleet["r1"]["Gauge"], bytes(30_000)

        def flood() -> set[type]:
            slow = gauge.send_req("slow0.3")
            calls: list[Future[Any]] = [gauge.set_value(load) for _ in range(1500)]
            calls += [gauge.get_value(timeout_s=WAIT_S) for _ in range(500)]
            kinds = {type(call.exception(timeout=WAIT_S)) for call in calls}
            slow.get()
            return kinds

        flood()
        before = running["r1"].memory_bytes()
        for _ in range(4):  # 200 MB in all
            kinds = flood()
            assert BusyError in kinds
            assert kinds <= {type(None), BusyError, UnsupportedError, StaleCommandError}
        assert running["r1"].memory_bytes() - before < 80_000_000
        assert gauge.get_value().get().value == -42


# Other clocks.


@pytest.mark.parametrize("shift_s", [1_000_000.0, -50.0])
def test_a_robots_clock_may_show_anything(rig: Rig, shift_s: float) -> None:
    program = other_clock(shift_s)
    with process(["-c", program, str(rig.file)], rig.folder) as server:
        server.wait_until_listening()
        with ready(Fleet(rig.config)) as fleet:
            assert [fleet["r1"]["Arm"].send_cmd(f"step{n}").get() for n in range(3)] == [0, 1, 2]
            assert fleet["r1"]["Arm"].send_cmd("move0.3").get() == 7
            server.freeze()
            late = fleet["r1"]["Arm"].send_cmd("step3")
            outlast_ttl(fleet["r1"])
            server.thaw()
            failure(late, StaleCommandError)
    assert rig.steps() == ["0", "1", "2"]


# Routers.


def test_a_router_that_is_restarted(tmp_path: Path) -> None:
    place = f"tcp/127.0.0.1:{free_port()}"
    rig = Rig(tmp_path, ("r1", "r2"), {"routers": [place], "dead_man_s": 20.0}, behind="router")
    router = ["-m", "eal_actors", "router", "--listen", place]
    with process(router, tmp_path) as first:
        first.wait_for(place)
        with served(rig) as (_, fleet):
            assert gather(robot["Arm"].send_cmd("step1") for robot in fleet.values()).get() == [1, 1]
            move = fleet["r1"]["Arm"].send_cmd("move2.5")
            assert rig.begun("move2.5")
            first.kill()
            for robot in fleet.values():
                assert becomes(robot, RobotState.LOST)
                failure(robot["Arm"].send_cmd("step2"), UnavailableError)
            with process(router, tmp_path) as second:
                second.wait_for(place)
                for robot in fleet.values():
                    assert becomes(robot, RobotState.READY)
                assert move.get() == 7  # the command continued, and its progress arrives again
                assert gather(robot["Arm"].send_cmd("step3") for robot in fleet.values()).get() == [3, 3]
                fleet.close()
    assert rig.never_twice()
    assert sorted((note.robot, note.what) for note in rig.notes("step")) == [
        ("r1", "1"),
        ("r1", "3"),
        ("r2", "1"),
        ("r2", "3"),
    ]
