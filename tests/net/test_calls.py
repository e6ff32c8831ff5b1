"""A remote robot behaves like a local one: answers, order, limits and stops."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eal_actors import Fleet, connect
from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import (
    ArgumentError,
    BusyError,
    CallCancelledError,
    DataError,
    DeadlineError,
    EALError,
    PreemptedError,
    RemoteError,
    ResourceFaultError,
    ResourceNotFoundError,
    ReturnTypeError,
    StaleCommandError,
    UnsupportedError,
)
from eal_actors.wire.format.packing import MAX_CALL_BYTES, MAX_PAYLOAD_BYTES
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, failure, ready
from tests.plugin_files import write_plugin

FRAME_BYTES = 921_600

Ask = Callable[[RobotHandle], Future[Any]]


@pytest.fixture
def pair(rig: Rig) -> Iterator[tuple[RobotHandle, RobotHandle]]:
    """The same robot twice: in this process, and through the network."""
    with Fleet(rig.local()) as local, rig.served_here() as fleet:
        yield local["r1"], fleet["r1"]


def outcome(call: Future[Any]) -> tuple[Any, ...]:
    """Return all that a caller can see of an outcome."""
    error = call.exception(timeout=WAIT_S)
    if isinstance(error, EALError):
        return type(error), str(error), error.robot, error.resource
    assert error is None, repr(error)
    value = call.get()
    if isinstance(value, EALData):
        header = (value.type, value.is_ptr, value.is_unsigned, value.is_short, value.is_long, value.shape)
        return (*header, value.length, bytes(value.payload), value.unit, value.frame_id)
    return type(value), value


SAME: dict[str, tuple[Ask, object]] = {
    "get_status": (lambda robot: robot["Gauge"].get_status(), 3),
    "get_value": (lambda robot: robot["Gauge"].get_value(), -42),
    "get_value of a frame": (lambda robot: robot["Eye"].get_value(), FRAME_BYTES),
    "set_value": (lambda robot: robot["Arm"].set_value(0.25), 1),
    "send_req": (lambda robot: robot["Gauge"].send_req("slow0.01"), 0.01),
    "send_req of nothing": (lambda robot: robot["Eye"].send_req("blob0"), 0),
    "send_cmd at once": (lambda robot: robot["Arm"].send_cmd("step-5"), -5),
    "send_cmd with a value": (lambda robot: robot["Arm"].send_cmd("put", 5), 1),
    "send_cmd that takes long": (lambda robot: robot["Arm"].send_cmd("move0.3"), 7),
    "send_cmd that stops": (lambda robot: robot["Arm"].send_cmd("s"), 1),
    "read_comm": (lambda robot: robot["Line"].read_comm(4), 0),
    "write_comm": (lambda robot: robot["Line"].write_comm(b"\x00\xffab"), 4),
    "write_comm of a part": (lambda robot: robot["Line"].write_comm(b"abcd", 2), 2),
    "get_config": (lambda robot: robot["Arm"].get_config("serial"), "W-1"),
    "set_config": (lambda robot: robot["Arm"].set_config("speed", 0.75), 1),
    "halt": (lambda robot: robot["Arm"].halt(), 1),
    "an unknown command": (lambda robot: robot["Arm"].send_cmd("mov1"), ArgumentError),
    "an argument out of range": (lambda robot: robot["Arm"].set_value(2.0), ArgumentError),
    "an argument of another type": (lambda robot: robot["Arm"].send_cmd("put", "text"), ArgumentError),
    "a read-only key": (lambda robot: robot["Arm"].set_config("serial", "W-2"), ArgumentError),
    "a key without its value": (lambda robot: robot["Arm"].set_config("speed"), ArgumentError),
    "an unknown key": (lambda robot: robot["Arm"].get_config("sped"), ArgumentError),
    "a refusal": (lambda robot: robot["Gauge"].send_req("refuse"), ArgumentError),
    "a method that lacks": (lambda robot: robot["Gauge"].set_value(1), UnsupportedError),
    "a command that lacks": (lambda robot: robot["Gauge"].send_cmd("go"), UnsupportedError),
    "a fault": (lambda robot: robot["Gauge"].send_req("fault"), ResourceFaultError),
    "a fault on the way": (lambda robot: robot["Arm"].send_cmd("jam"), ResourceFaultError),
    "an answer of another type": (lambda robot: robot["Gauge"].send_req("text"), ReturnTypeError),
}


def test_local_and_remote_answer_alike(pair: tuple[RobotHandle, RobotHandle]) -> None:
    local, remote = pair
    answers = {what: outcome(ask(remote)) for what, (ask, _) in SAME.items()}
    assert answers == {what: outcome(ask(local)) for what, (ask, _) in SAME.items()}


def test_the_answers_are_what_the_plugin_gives(remote: RobotHandle) -> None:
    for what, (ask, expected) in SAME.items():
        error = ask(remote).exception(timeout=WAIT_S)
        if isinstance(expected, type):
            assert type(error) is expected, what
            continue
        value = ask(remote).get()
        if isinstance(value, EALData):
            value = value.value if isinstance(expected, str) or 0 < value.length < 16 else value.length
        assert (value, error) == (expected, None), what


def test_what_is_set_stays_set(remote: RobotHandle) -> None:
    remote["Arm"].set_value(-0.5).get()
    remote["Arm"].set_config("speed", 0.125).get()
    remote["Line"].write_comm(b"first ").get()
    remote["Line"].write_comm(b"second").get()
    assert remote["Arm"].get_value().get().value == -0.5
    assert remote["Arm"].get_config("speed").get().value == 0.125
    assert bytes(remote["Line"].read_comm(100).get().payload) == b"first second"


def test_a_robot_says_the_same_of_itself(pair: tuple[RobotHandle, RobotHandle]) -> None:
    local, remote = pair
    assert list(remote) == list(local) == ["Arm", "Gauge", "Eye", "Line", "Watch"]
    assert [handle.info for handle in remote.values()] == [handle.info for handle in local.values()]
    with pytest.raises(ResourceNotFoundError, match="did you mean 'Gauge'"):
        remote["Guage"]


WORDY = """
from eal_actors.plugin import EALPlugin, Resource, ResourceType
class Wordy(Resource):
    types = ResourceType.SENSOR
    def not_ready(self):
        return "n" * 1_100_000
def connect():
    plugin = EALPlugin("Wordy")
    plugin.left_out = ("no camera", "o" * 1_100_000)
    return plugin
"""
SILENT = """
def connect():
    raise RuntimeError("x" * 1_100_000)
"""


def test_long_texts_of_plugins_keep_nobody_out(rig: Rig) -> None:
    write_plugin(rig.folder, "wordy", WORDY, "Wordy")
    write_plugin(rig.folder, "silent", SILENT, "Silent")
    rig.content["plugin_dirs"].append("plugins")
    rig.content["robots"]["r1"]["plugins"] |= {"wordy": {}, "silent": {}}
    rig.write()
    with rig.served_here() as fleet:
        robot = fleet["r1"]
        assert robot["Gauge"].get_value().get().value == -42
        assert robot.ping().get().not_ready["Wordy"].startswith("nnn")
        assert "connect raised RuntimeError: xxx" in str(robot.problems[0])
        with pytest.raises(ResourceNotFoundError, match=r"'Camera'.*; left out: no camera; left out: ooo"):
            robot["Camera"]


def test_resources_themselves_cannot_be_had(rig: Rig) -> None:
    with rig.served_here() as fleet, connect("r1", fleet=fleet) as eal:
        with pytest.raises(RemoteError, match="is not available over a network") as caught:
            eal.get_resource("Arm")
        assert caught.value.robot == "r1"
        assert eal.get_value(eal.find_resource("Gauge")).value == -42


# Values.


def test_a_frame_arrives_as_it_was(remote: RobotHandle) -> None:
    frame = remote["Eye"].get_value().get()
    assert (frame.length, frame.shape, frame.type) == (FRAME_BYTES, (480, 640, 3), DataType.CHAR)
    expected = (np.arange(FRAME_BYTES) % 251).astype(np.uint8).reshape(480, 640, 3)
    assert np.array_equal(np.asarray(frame.value), expected)
    assert remote["Eye"].set_value(expected).get() == FRAME_BYTES


def test_8_megabytes_pass_to_a_robot_and_64_from_it(remote: RobotHandle) -> None:
    most = np.zeros(MAX_CALL_BYTES, np.uint8)
    taken = remote["Eye"].set_value(most)
    for _ in range(3):  # expired, and so not done, if the machine needs more than a second to deliver it
        if not isinstance(taken.exception(timeout=WAIT_S), StaleCommandError):
            break
        taken = remote["Eye"].set_value(most)
    assert taken.get() == MAX_CALL_BYTES
    assert remote["Eye"].send_req(f"blob{MAX_PAYLOAD_BYTES}").get().length == MAX_PAYLOAD_BYTES


def test_one_byte_more_is_refused_in_both_directions(remote: RobotHandle) -> None:
    over = np.zeros(MAX_CALL_BYTES + 1, np.uint8)
    calls: dict[int, Future[Any]] = {MAX_CALL_BYTES: remote["Eye"].set_value(over)}
    calls[MAX_PAYLOAD_BYTES] = remote["Eye"].send_req(f"blob{MAX_PAYLOAD_BYTES + 1}")
    for most, call in calls.items():
        error = failure(call, DataError)
        assert str(error) == f"r1/Eye: a value of {most + 1} bytes is over the {most} that one message may carry"
    assert remote["Eye"].get_status().exception(timeout=WAIT_S) is not None  # unsupported, but it answers
    assert not remote._actor.calls.tracker.commands  # type: ignore[attr-defined]  # what could not be sent is not kept


# Time.


def test_a_deadline_passes_at_the_caller_and_at_the_robot(rig: Rig, remote: RobotHandle) -> None:
    clock = SystemClock()
    failure(remote["Arm"].send_cmd("move30", timeout_s=0.5), DeadlineError)
    assert clock.now() < 5.0
    assert eventually(lambda: rig.notes("halt"))
    assert remote["Arm"].get_status().get() == 0
    assert not rig.notes("end")


def test_what_waits_beyond_its_deadline_is_never_begun(rig: Rig, remote: RobotHandle) -> None:
    slow = remote["Gauge"].send_req("slow0.8")
    late = remote["Gauge"].send_req("slow0.001", timeout_s=0.2)
    failure(late, DeadlineError)
    slow.get()
    remote["Gauge"].get_value().get()
    assert [note.what for note in rig.notes("slow")] == ["0.8"]


def test_a_negative_time_out_is_over_at_once(remote: RobotHandle) -> None:
    failure(remote["Gauge"].get_value(timeout_s=-1.0), DeadlineError)
    failure(remote["Arm"].send_cmd("step1", timeout_s=0.0), DeadlineError)


# Order.


def test_commands_keep_their_order(rig: Rig, remote: RobotHandle) -> None:
    numbers = range(200)
    assert gather([remote["Arm"].send_cmd(f"step{n}") for n in numbers]).get() == list(numbers)
    assert [note.what for note in rig.notes("step")] == [str(n) for n in numbers]


def test_threads_share_a_robot(rig: Rig, remote: RobotHandle) -> None:
    def command(thread: int) -> None:
        for n in range(40):
            assert remote["Arm"].send_cmd(f"step{1000 * thread + n}").get() == 1000 * thread + n

    threads = [threading.Thread(target=command, args=(number,)) for number in range(1, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(WAIT_S)
    steps = [int(note.what) for note in rig.notes("step")]
    assert len(steps) == len(set(steps)) == 160
    for number in range(1, 5):
        own = [step for step in steps if step // 1000 == number]
        assert own == sorted(own)


def test_a_newer_command_takes_over(rig: Rig, remote: RobotHandle) -> None:
    older = remote["Arm"].send_cmd("move30")
    assert rig.begun("move30")
    assert remote["Arm"].send_cmd("step1").get() == 1
    assert "a newer command took over: 'step1'" in str(failure(older, PreemptedError))


def test_a_halt_overtakes_what_waits(rig: Rig, remote: RobotHandle) -> None:
    running = remote["Arm"].send_cmd("move30")
    assert rig.begun("move30")
    slow = remote["Gauge"].send_req("slow1")
    assert remote["Arm"].halt().get() == 1
    failure(running, PreemptedError)
    assert not slow.done()
    slow.get()
    assert not rig.notes("end")


def test_statuses_are_answered_while_a_command_runs(rig: Rig, remote: RobotHandle) -> None:
    running = remote["Arm"].send_cmd("move30")
    assert rig.begun("move30")
    assert remote["Arm"].get_status().get() == 1
    assert not running.done()


def test_cancelling_stops_the_motion(rig: Rig, remote: RobotHandle) -> None:
    running = remote["Arm"].send_cmd("move30")
    assert rig.begun("move30")
    assert running.cancel()
    failure(running, CallCancelledError)
    assert eventually(lambda: rig.notes("halt"))
    assert remote["Arm"].get_status().get() == 0
    assert not rig.notes("end")


def test_cancelling_at_once_leaves_nothing_running(rig: Rig, remote: RobotHandle) -> None:
    for n in range(20):
        remote["Arm"].send_cmd(f"move{30 + n}").cancel()
    assert remote["Arm"].send_cmd("step1").get() == 1
    assert eventually(lambda: remote["Arm"].get_status().get() == 0)
    assert not remote._actor.calls.tracker.commands  # type: ignore[attr-defined]
    assert not rig.notes("end")


# Load.


def test_a_flood_is_answered_with_busy(remote: RobotHandle) -> None:
    slow = remote["Gauge"].send_req("slow1")
    flood = [remote["Gauge"].get_value(timeout_s=WAIT_S) for _ in range(1500)]
    errors = [call.exception(timeout=WAIT_S) for call in flood]
    slow.get()
    refused = [error for error in errors if error is not None]
    assert refused
    assert all(isinstance(error, BusyError) for error in refused), set(map(repr, refused))
    assert len(errors) - len(refused) >= 100
    assert remote["Gauge"].get_value().get().value == -42


def test_a_flood_does_not_hold_up_a_halt(rig: Rig, remote: RobotHandle) -> None:
    running = remote["Arm"].send_cmd("move30")
    assert rig.begun("move30")
    flood = [remote["Eye"].get_value(timeout_s=WAIT_S) for _ in range(60)]
    assert remote["Arm"].halt().get() == 1
    assert not all(call.done() for call in flood)
    failure(running, PreemptedError)
    gather(flood, return_exceptions=True).get()


def test_outcomes_of_commands_get_through_beside_frames(remote: RobotHandle) -> None:
    """The outcome of a long command arrives as an event during a flood of frames."""
    for _ in range(5):
        moves = remote["Arm"].send_cmd("move0.15")
        frames = [remote["Eye"].get_value(timeout_s=WAIT_S) for _ in range(60)]
        assert moves.get(timeout=WAIT_S) == 7
        gather(frames, return_exceptions=True).get()


# Closing.


def test_a_fleet_may_leave_and_come_back(rig: Rig) -> None:
    with rig.served_here() as fleet:
        for n in range(3):
            with ready(Fleet(rig.config)) as other:
                fleet.close()
                assert other["r1"]["Arm"].send_cmd(f"step{n}").get() == n


def test_local_and_remote_robots_make_one_fleet(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("near", "far"))
    del rig.content["robots"]["near"]["address"]
    rig.write()
    with ExitStack() as stack:
        from eal_actors.facade.service import RobotService

        stack.enter_context(RobotService(rig.config, "far"))
        fleet = stack.enter_context(ready(Fleet(rig.config)))
        assert gather(robot["Arm"].send_cmd("step1") for robot in fleet.values()).get() == [1, 1]
        assert sorted(note.robot for note in rig.notes("step")) == ["far", "near"]
