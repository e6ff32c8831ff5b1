"""Several controllers of one robot, emergency stops and halts over the network."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pykka import ActorRegistry

from eal_actors import Fleet
from eal_actors.actors.combine import gather
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState, process_name
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import (
    BusyError,
    CallCancelledError,
    ConfigError,
    DataError,
    DeadlineError,
    EALError,
    PreemptedError,
    ResourceBusyError,
    StoppedError,
    UnavailableError,
)
from eal_actors.scenario import Run, load_scenario, make_plan
from eal_actors.wire.rpc.server.host import RobotHost
from tests.log_lines import log_lines
from tests.net.links import eventually
from tests.net.rig import LONGER_THAN_TTL_S, WAIT_S, Rig, becomes, failure, hold_calls, ready

# Stops.


def test_an_emergency_stop_holds_over_the_network(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("r1", "r2"))
    with rig.served_here() as fleet:
        moves = [robot["Arm"].send_cmd("move30") for robot in fleet.values()]
        assert eventually(lambda: len(rig.notes("begin")) == 2)
        fleet.stop("somebody is in the way").get()
        for robot, move in zip(fleet.values(), moves, strict=True):
            failure(move, PreemptedError)
            refused = failure(robot["Arm"].send_cmd("step1"), StoppedError)
            assert "somebody is in the way" in str(refused)
            assert robot["Gauge"].get_value().get().value == -42
        with Fleet(rig.config) as other:  # later controllers receive the reason too
            assert other["r1"].stopped_because == "somebody is in the way"
            failure(other["r1"]["Arm"].send_cmd("step2"), StoppedError)
        fleet.resume().get()
        for number, robot in enumerate(fleet.values()):
            assert robot.stopped_because is None
            assert robot["Arm"].send_cmd(f"step{10 + number}").get() == 10 + number
        assert [note.what for note in rig.notes("step")] == ["10", "11"]


@pytest.mark.parametrize("reason", ["\udcff", "x" * 2_000_000, OSError("no camera"), None], ids=type)
def test_a_stop_with_any_reason_stops_the_robot(rig: Rig, reason: Any) -> None:
    with rig.served_here() as fleet:
        robot = fleet["r1"]
        move = robot["Arm"].send_cmd("move30")
        assert rig.begun("move30")
        robot.stop(reason).get(timeout=WAIT_S)  # the caller has no other way to tell of an exception or a file's name
        failure(move, PreemptedError)
        assert robot.ping().get(timeout=WAIT_S).stopped
        robot.resume().get(timeout=WAIT_S)
        assert robot["Arm"].send_cmd("step1").get() == 1


def test_a_request_that_cannot_be_sent_fails_alone(remote: RobotHandle) -> None:
    failure(remote.release("x" * 2_000_000), DataError)
    assert remote["Arm"].send_cmd("step1").get() == 1
    remote.stop("somebody is in the way").get(timeout=WAIT_S)


def test_a_stop_is_logged_before_the_resume_that_ends_it(remote: RobotHandle) -> None:
    with log_lines() as log:
        for _ in range(3):
            remote.stop("somebody is in the way").get(timeout=WAIT_S)
            remote.resume().get(timeout=WAIT_S)
    events = [json.loads(line)["event"] for line in log.getvalue().splitlines()]
    assert [event for event in events if event in {"emergency stop", "resumed"}] == ["emergency stop", "resumed"] * 3


def test_a_stop_of_another_controller_is_a_stop(rig: Rig) -> None:
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as other:
        move = fleet["r1"]["Arm"].send_cmd("move30")
        assert rig.begun("move30")
        other.stop("the other one").get()
        failure(move, PreemptedError)
        assert "the other one" in str(failure(fleet["r1"]["Arm"].send_cmd("step1"), StoppedError))
        other.resume().get()
        assert eventually(lambda: fleet["r1"]["Arm"].send_cmd("step2").exception(timeout=WAIT_S) is None)


MAILBOX = 256


def test_a_halt_drops_what_waits_for_its_own_resource_alone(rig: Rig, remote: RobotHandle) -> None:
    gate = hold_calls(remote)
    dropped, kept = remote["Arm"].send_cmd("step1"), remote["Eye"].set_value(np.zeros(3, np.uint8))
    assert remote["Arm"].halt().get() == 1  # before all queued calls
    gate.set()
    failure(dropped, PreemptedError)
    assert kept.get() == 3
    assert not rig.notes("step")


def test_what_waits_to_be_sent_does_not_get_stale(rig: Rig, remote: RobotHandle) -> None:
    gate = hold_calls(remote)
    step = remote["Arm"].send_cmd("step1")
    failure(remote["Gauge"].get_value(timeout_s=LONGER_THAN_TTL_S), DeadlineError)
    gate.set()
    assert step.get() == 1  # older than its time to live, which begins when it is sent


def test_no_more_than_so_many_calls_to_a_resource_are_under_way(rig: Rig, remote: RobotHandle) -> None:
    gate = hold_calls(remote)
    calls = [remote["Gauge"].get_value() for _ in range(MAILBOX + 1)]
    assert f"r1/Gauge: {MAILBOX} calls are pending" in str(failure(calls.pop(), BusyError))
    gate.set()
    gather(calls).get()


def test_a_frozen_resource_makes_no_other_one_busy(rig: Rig, remote: RobotHandle) -> None:
    slow = remote["Gauge"].send_req("slow1")
    reads = [remote["Gauge"].get_value() for _ in range(MAILBOX + 10)]
    assert remote["Arm"].send_cmd("step1").get() == 1
    assert remote["Eye"].get_value().get().value.shape == (480, 640, 3)
    assert remote["Gauge"].halt().exception() is None
    kinds = [type(read.exception(timeout=WAIT_S)) for read in reads]
    assert kinds == [type(None)] * (MAILBOX - 1) + [BusyError] * 11
    assert slow.get() is not None


def test_the_fleet_file_sets_the_size_of_a_mailbox(rig: Rig) -> None:
    rig.content["robots"]["r1"]["mailbox"] = 4
    rig.write()
    with rig.served_here() as fleet:
        gate = hold_calls(fleet["r1"])
        reads = [fleet["r1"]["Gauge"].get_value() for _ in range(5)]
        assert "4 calls are pending" in str(failure(reads.pop(), BusyError))
        gate.set()
        gather(reads).get()


def test_a_status_is_asked_for_while_no_more_calls_are_taken(rig: Rig, remote: RobotHandle) -> None:
    gate = hold_calls(remote)
    calls = [remote["Gauge"].get_value() for _ in range(MAILBOX)]
    status = remote["Arm"].get_status()
    gate.set()
    assert status.get() == 0
    gather(calls).get()


def test_what_is_given_up_before_it_leaves_takes_no_call_s_place(rig: Rig, remote: RobotHandle) -> None:
    gate = hold_calls(remote)
    for n in range(4 * MAILBOX):
        step = remote["Arm"].send_cmd(f"step{n}")
        step.cancel()
        failure(step, CallCancelledError)  # and not BusyError
    kept = remote["Arm"].send_cmd("step7000")
    gate.set()
    assert kept.get() == 7000
    assert rig.steps() == ["7000"]


def test_a_stop_is_not_held_up_by_other_robots_links(rig: Rig, remote: RobotHandle) -> None:
    gate = threading.Event()
    controller = remote._actor._controller  # type: ignore[attr-defined]
    for sender in (controller.sender, controller._urgent_sender):
        sender.actor_inbox.call_soon(lambda: gate.wait(WAIT_S) and None)
    remote.stop("a stalled link elsewhere").get()
    assert remote["Arm"].halt().get() == 1
    gate.set()
    remote.resume().get()
    assert remote["Arm"].send_cmd("step1").get() == 1


# Several controllers.


def test_an_actuator_obeys_one_controller_at_a_time(rig: Rig) -> None:
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as other:
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        busy = failure(other["r1"]["Arm"].send_cmd("step2"), ResourceBusyError)
        assert f"held by controller {process_name()}" in str(busy)
        assert other["r1"].ping().get().holders == {"Arm": process_name()}
        assert other["r1"]["Arm"].get_value().get().value == 0.0
        assert other["r1"]["Eye"].set_value(b"sensors are nobody's").get() == 20
        assert other["r1"]["Arm"].halt().get() == 1  # a reading needs no lease
        assert fleet["r1"]["Arm"].send_cmd("step3").get() == 3
        fleet.close()
        assert other["r1"]["Arm"].send_cmd("step4").get() == 4
    assert [note.what for note in rig.notes("step")] == ["1", "3", "4"]


def test_the_fleet_file_says_what_is_for_one_controller_at_a_time(rig: Rig) -> None:
    rig.content["robots"]["r1"]["exclusive"] = ["Eye"]
    rig.write()
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as other:
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        assert other["r1"]["Arm"].send_cmd("step2").get() == 2
        assert fleet["r1"]["Eye"].set_value(b"mine").get() == 4
        assert "held by controller" in str(failure(other["r1"]["Eye"].set_value(b"mine, too"), ResourceBusyError))
        assert other["r1"].ping().get().holders == {"Eye": process_name()}


def test_what_is_exclusive_must_be_there(rig: Rig) -> None:
    rig.content["robots"]["r1"]["exclusive"] = ["Eye", "Amr"]
    rig.write()
    with pytest.raises(ConfigError, match=r"robots\.r1\.exclusive: .*'Amr'; did you mean 'Arm'"):
        RobotService(rig.config, "r1").open()


def test_a_server_that_loses_its_own_actor_halts_its_robots(rig: Rig) -> None:
    with RobotService(rig.config, "r1") as service, ready(Fleet(rig.config)) as fleet:
        running = fleet["r1"]["Arm"].send_cmd("move30")
        assert rig.begun("move30")
        (host,) = ActorRegistry.get_by_class(RobotHost)

        def die() -> None:
            raise SystemExit("an error of ours")

        host.actor_inbox.call_soon(die)  # type: ignore[attr-defined]  # Pykka knows its own inboxes alone
        assert becomes(fleet["r1"], RobotState.LOST)
        failure(running, EALError)
        assert eventually(lambda: service.robot["Arm"].get_status().get() == 0)
        assert not rig.notes("end")
        with pytest.raises(UnavailableError, match="r1: its server has crashed; the robot is halted"):
            service.wait()  # so that `eal serve` ends and its supervisor restarts it


def test_what_a_controller_lets_go_of_another_may_command_at_once(rig: Rig) -> None:
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as other:
        mine, theirs = fleet["r1"], other["r1"]
        assert mine["Arm"].send_cmd("step1").get() == 1
        assert mine.ping().get().holder_ids == {"Arm": mine.controller_id}
        assert theirs.ping().get().holders == mine.ping().get().holders
        assert theirs.ping().get().holder_ids == {}  # only its own are disclosed
        theirs.release().get()  # of what it does not hold: nothing happens
        failure(theirs["Arm"].send_cmd("step2"), ResourceBusyError)
        mine.release("Arm").get()
        assert theirs.ping().get().holders == {}
        assert theirs["Arm"].send_cmd("step3").get() == 3
        assert theirs.ping().get().holder_ids == {"Arm": theirs.controller_id}
        failure(mine["Arm"].send_cmd("step4"), ResourceBusyError)
    assert [note.what for note in rig.notes("step")] == ["1", "3"]


def test_what_still_moves_is_halted_when_its_controller_lets_go(rig: Rig) -> None:
    with rig.served_here() as fleet:
        move = fleet["r1"]["Arm"].send_cmd("move30")
        assert rig.begun("move30")
        fleet["r1"].release("Eye").get()
        assert fleet["r1"]["Arm"].get_status().get() == 1
        fleet["r1"].release().get()
        failure(move, PreemptedError)
    assert not rig.notes("end")


def test_a_command_right_behind_a_release_is_carried_out(rig: Rig, remote: RobotHandle) -> None:
    assert remote["Arm"].send_cmd("step0").get() == 0
    for number in range(1, 20):
        released, step = remote.release("Arm"), remote["Arm"].send_cmd(f"move0.0{number:02d}")
        released.get()
        step.get()
    assert len(rig.notes("end")) == 19


def test_a_robot_of_this_process_is_held_by_nobody(rig: Rig) -> None:
    with Fleet(rig.local()).connect() as fleet:
        robot = fleet["r1"]
        move = robot["Arm"].send_cmd("move30")
        assert rig.begun("move30")
        robot.release("Arm").get()
        assert robot.controller_id is None
        assert robot["Arm"].get_status().get() == 1
        move.cancel()


def test_a_stop_command_is_for_everybody_too(rig: Rig) -> None:
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as other:
        move = fleet["r1"]["Arm"].send_cmd("move30")
        assert rig.begun("move30")
        assert other["r1"]["Arm"].send_cmd("s").get() == 1
        failure(move, PreemptedError)


def test_a_controller_that_leaves_halts_what_it_moved(rig: Rig) -> None:
    with rig.served_here() as fleet:
        fleet["r1"]["Arm"].send_cmd("move30")
        assert rig.begun("move30")
        with ready(Fleet(rig.config)):
            pass
        assert fleet["r1"]["Arm"].get_status().get() == 1  # the other controller did not hold it
        fleet.close()
        assert eventually(lambda: rig.notes("halt"))
    assert not rig.notes("end")


@pytest.mark.parametrize("policy", ["abort", "drop"])
def test_a_stop_of_another_controller_aborts_a_run(rig: Rig, policy: str) -> None:
    file = rig.folder / "move.yaml"
    file.write_text(
        f"version: 1\nname: move\non_failure: {policy}\nroles: {{all: {{robots: [r1]}}}}\nsteps:\n"
        "  - on: all\n    do: [{send_cmd: {resource: Arm, cmd: move30}, timeout_s: 60}]\n"
    )
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as other:
        run = Run(make_plan(load_scenario(file), fleet), fleet)
        future = run.start()
        assert rig.begun("move30")
        other.stop("the other one").get()
        report = future.get(timeout=WAIT_S)
        other.resume().get()
    assert report.outcome == "aborted"
    assert report.error is not None
    assert report.error.message.count("an emergency stop holds the robot: the other one") == 1
