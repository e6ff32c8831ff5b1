"""Progress, running commands, states and times across a network."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.call import Call
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState, RunningCommand, process_name
from eal_actors.device.data import EALData
from eal_actors.device.resource import Progress
from eal_actors.kernel.errors import PreemptedError, UnavailableError
from eal_actors.wire.format.messages import RobotEvent
from eal_actors.wire.rpc.client.controller import RobotListener
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, becomes, failure, other_clock, process, ready, served


def test_progress_comes_through_the_network_now_and_again(fleet: Fleet) -> None:
    heard: list[Progress] = []
    move = fleet["r1"]["Arm"].send_cmd("move1")
    move.add_progress_callback(heard.append)
    assert move.get() == 7
    fractions = [progress.fraction for progress in heard]
    assert 2 <= len(heard) <= 5  # of some fifty steps, four in a second at most
    assert fractions == sorted(fractions)  # type: ignore[type-var]  # each is reported
    assert heard[-1].text.endswith("s left")
    assert move.progress() is heard[-1]
    assert all(0 < progress.time_s < fleet.clock.now() for progress in heard)


def test_progress_with_any_text_arrives(fleet: Fleet) -> None:
    heard: list[str] = []
    move = fleet["r1"]["Arm"].send_cmd("mumble1")
    move.add_progress_callback(lambda progress: heard.append(progress.text))
    assert move.get() == 1
    assert heard == ["\\udcff"]


def listed(robot: RobotHandle) -> list[tuple[str, str, str]]:
    return [(running.resource, running.command, running.by) for running in robot.running]


def test_who_comes_later_sees_what_runs(rig: Rig, fleet: Fleet) -> None:
    mine = ("Arm", "move30", process_name())
    move = fleet["r1"]["Arm"].send_cmd("move30")
    assert eventually(lambda: listed(fleet["r1"]) == [mine])
    with ready(Fleet(rig.config)) as late:
        robot = late["r1"]
        assert listed(robot) == [mine]
        assert [running.command for running in robot.ping().get().running] == ["move30"]

        def fraction() -> float:
            (running,) = robot.running
            assert running.progress is not None
            assert running.progress.fraction is not None
            return running.progress.fraction

        first = fraction()
        assert eventually(lambda: fraction() > first)  # kept current
        age_s = late.clock.now() - robot.running[0].since_s
        assert 0 < age_s < WAIT_S
        fleet["r1"]["Arm"].halt().get()
        assert eventually(lambda: not robot.running)
        failure(move, PreemptedError)
        assert not robot.ping().get().running


def test_a_short_command_is_never_listed(fleet: Fleet) -> None:
    seen: list[tuple[RunningCommand, ...]] = []
    assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
    seen.append(fleet["r1"].ping().get().running)
    assert seen == [()]


def test_an_outcome_whose_event_got_lost_is_asked_for(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    connection: Any = fleet["r1"]._actor
    listener: RobotListener = connection._listener
    lost: list[RobotEvent] = []

    def lossy(event: RobotEvent) -> None:
        if event.kind == "result" and not lost:
            lost.append(event)
        else:
            listener.on_event(event)

    monkeypatch.setitem(connection._controller._listeners, "r1", listener._replace(on_event=lossy))
    assert fleet["r1"]["Arm"].send_cmd("move0.5", timeout_s=WAIT_S).get() == 7
    assert len(lost) == 1
    assert not fleet["r1"].running


def test_an_outcome_that_comes_behind_the_sign_of_life_is_the_outcome(rig: Rig, fleet: Fleet) -> None:
    robot = fleet["r1"]
    move = robot["Arm"].send_cmd("move0.05")
    robot._actor._listener.on_gone("goes")  # type: ignore[attr-defined]  # before anything is answered: the move takes longer
    assert move.get() == 7
    assert len(rig.notes("begin")) == 1


def test_states_are_events(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        states: list[RobotState] = []
        robot.on_state(states.append)
        lost = robot.wait_for_state(RobotState.LOST, WAIT_S)
        move = robot["Arm"].send_cmd("move30")
        assert eventually(lambda: robot.running)
        running["r1"].kill()
        assert lost.get() is RobotState.LOST
        assert robot.problems
        assert not robot.running
        back = robot.wait_for_state(RobotState.READY, WAIT_S)
        running.start("r1")
        assert back.get() is RobotState.READY
        failure(move, UnavailableError)
        assert not robot.running
        assert states == [RobotState.READY, RobotState.LOST, RobotState.READY]


def test_a_running_command_of_a_dead_robot_fails_long_before_its_deadline(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network={"dead_man_s": 0.5})
    with served(rig) as (running, fleet):
        move = fleet["r1"]["Arm"].send_cmd("move60", timeout_s=10_000)
        assert eventually(lambda: fleet["r1"].running)
        running["r1"].kill()
        assert "its outcome is unknown: the robot is unreachable" in str(failure(move, UnavailableError))
        running.start("r1")
        assert becomes(fleet["r1"], RobotState.READY)
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1


# Times.


def truly_s(fleet: Fleet, data: EALData) -> float:
    """Return when a reading of the watch was made, by the fleet's clock: its value is the machine's time."""
    age_s = time.clock_gettime(time.CLOCK_MONOTONIC) - float(data.value)
    return fleet.clock.now() - fleet.clock.of_real(age_s)


@pytest.mark.parametrize("rate", [1, 4])
def test_values_are_stamped_by_the_readers_clock(tmp_path: Path, rate: int) -> None:
    """The server's clock is far behind."""
    rig = Rig(tmp_path, extra={"clock": {"rate": rate}})
    server = process(["-c", other_clock(-50.0), str(rig.file)], rig.folder)
    with server, ready(Fleet(rig.config)) as fleet:
        watch = fleet["r1"]["Watch"]
        ping = fleet["r1"].ping().get()
        assert abs(ping.offset_s) > 10 * ping.offset_error_s
        readings: list[Call[EALData]] = [watch.get_value(), watch.read_comm(1)]
        for call in readings:
            data = call.get()
            assert data.stamp_s is not None
            assert 0 < call.stamp_error_s < 0.1 * rate
            assert data.stamp_s == pytest.approx(truly_s(fleet, data), abs=call.stamp_error_s + 0.005 * rate)
        watch.set_value(EALData.of(1, stamp_s=fleet.clock.now() - 100.0)).get()
        assert watch.send_req("age").get().value == pytest.approx(100.0, abs=0.5 * rate)


def test_the_shown_names_hold_no_tricks() -> None:
    from eal_actors.wire.rpc.server.admission import ControllerNames

    names = ControllerNames()
    assert names.of("ab") == "ab"
    names.note("ab", "_", " anna@\x1b[31mlab\n ")
    assert names.of("ab") == "anna@[31mlab"
    names.note("ab", "_", "\n")
    assert names.of("ab") == "anna@[31mlab"
    names.note("cd", "_", "x" * 1000)
    assert len(names.of("cd")) == 100
    for number in range(2000):
        names.note(f"{number:032x}", "_", "somebody")
    assert names.of(32 * "0") == 32 * "0"  # forgotten: as many as that are never under way
    assert names.of("ab") == "anna@[31mlab"  # of another certificate
