"""Calls that wait together are sent together: in the order of their submission, each answered by itself."""

from __future__ import annotations

import contextlib
import random
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet, gather
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.resource import Resource, command
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import ArgumentError, EALError, ProtocolError, StoppedError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.format.batches import MAX_ROWS, encode_batch
from eal_actors.wire.format.packing import PROTOCOL_VERSION, pack
from eal_actors.wire.rpc.server.host import RobotHost
from eal_actors.wire.session import open_session, robot_config
from tests.net.host import crowd
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, hold_calls, ready
from tests.robots import running_robot

ROBOTS = 6


class Counter(Resource):
    """Steps by one with each command, and notes the threads that read it."""

    types = ResourceType.ACTUATOR

    def __init__(self) -> None:
        self.steps: list[str] = []
        self.readers: list[str] = []

    def get_value(self) -> EALData:
        self.readers.append(threading.current_thread().name)
        return EALData.of(len(self.steps))

    @command("step<name>", ValueInfo(DataType.CHAR))
    def step(self, name: str) -> int:
        """Step."""
        if name == "wrong":
            raise ArgumentError("no such step")
        self.steps.append(name)
        return len(self.steps)


class QuickCounter(Counter):
    """One whose value takes no time to read."""

    types = ResourceType.SENSOR

    def glance(self) -> EALData:
        return EALData.of(len(self.steps))


class Crowd:
    """Robots of one process and a fleet that is connected to them.

    Attributes:
        config: the fleet's.
        host: serves the robots.
        received: rows of each message with calls of resources that the host has received.
        fleet: the fleet.
        counters: the resources.
    """

    def __init__(self, stack: ExitStack, config: FleetConfig, monkeypatch: pytest.MonkeyPatch) -> None:
        self.config = config
        self.received: list[int] = []
        self.counters = {name: (Counter(), QuickCounter()) for name in config.robots}
        receive, receive_batch = RobotHost._receive, RobotHost._receive_batch

        def on_call(host: RobotHost, link: None, key: str, envelope: bytes, payload: bytes) -> None:
            if "/Counter/" in key:
                self.received.append(1)
            receive(host, link, key, envelope, payload)

        def on_batch(host: RobotHost, key: str, route: Any, rows: list[list[Any]]) -> None:
            self.received[-1:] = [len(rows)]
            receive_batch(host, key, route, rows)

        monkeypatch.setattr(RobotHost, "_receive", on_call)
        monkeypatch.setattr(RobotHost, "_receive_batch", on_batch)
        session = stack.enter_context(open_session(robot_config(config, "r1")))
        self.host = RobotHost(config.name, session, config.network).launch()
        stack.callback(self.host.close, 5.0)
        for name, (counter, quick) in self.counters.items():
            made = {"Counter": lambda counter=counter: counter, "Quick": lambda quick=quick: quick}
            robot = stack.enter_context(running_robot(made, name=name, clock=SystemClock()))
            stack.callback(self.host.serve(robot).close)
        self.fleet = stack.enter_context(ready(Fleet(config)))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Crowd]:
    with ExitStack() as stack:
        rig = Rig(tmp_path, network={"shared_memory": False})  # batches are for the engine's links
        yield Crowd(stack, crowd(rig.config, ROBOTS), monkeypatch)


def test_calls_that_wait_together_take_one_message(here: Crowd) -> None:
    gate = hold_calls(here.fleet["r1"])
    calls = {
        (name, str(number)): robot["Counter"].send_cmd(f"step{number}")
        for number in range(20)
        for name, robot in here.fleet.items()
    }
    wrong = here.fleet["r1"]["Counter"].send_cmd("stepwrong")
    gate.set()
    assert {key: call.get(timeout=WAIT_S) for key, call in calls.items()} == {
        (name, number): int(number) + 1 for name, number in calls
    }
    assert isinstance(wrong.exception(timeout=WAIT_S), ArgumentError)
    assert all(counter.steps == [str(n) for n in range(20)] for counter, _ in here.counters.values())
    assert here.received == [len(calls) + 1]


def test_a_crowd_of_callers_shares_messages(here: Crowd) -> None:
    def call(robot: RobotHandle) -> None:
        for _ in range(50):
            robot["Counter"].get_value().get(timeout=WAIT_S)

    callers = [threading.Thread(target=call, args=(robot,)) for robot in here.fleet.values() for _ in range(2)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(WAIT_S)
    assert sum(here.received) == 50 * len(callers)
    assert len(here.received) < sum(here.received) / 2


def test_more_calls_than_a_batch_holds_all_arrive(here: Crowd) -> None:
    gate = hold_calls(here.fleet["r1"])
    calls = [here.fleet["r1"]["Counter"].get_value() for _ in range(200)]
    calls += [here.fleet["r2"]["Counter"].get_value() for _ in range(MAX_ROWS - 100)]
    gate.set()
    assert gather(calls).get(timeout=WAIT_S)
    assert sum(here.received) == len(calls)
    assert max(here.received) <= MAX_ROWS


def test_a_stop_overtakes_a_batch(here: Crowd) -> None:
    gate = hold_calls(here.fleet["r1"])
    steps = [robot["Counter"].send_cmd("step1") for robot in here.fleet.values()]
    here.fleet.stop("enough").get(timeout=WAIT_S)
    gate.set()
    for step in steps:
        assert isinstance(step.exception(timeout=WAIT_S), EALError)
    assert not any(counter.steps for counter, _ in here.counters.values())
    assert isinstance(here.fleet["r1"]["Counter"].send_cmd("step2").exception(timeout=WAIT_S), StoppedError)


def test_calls_of_several_processes_arrive_where_they_belong(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("r1", "r2", "r3"), {"shared_memory": False})
    with rig.served_here() as fleet:  # each robot has a session of its own, as in a process of its own
        calls = [
            robot["Arm"].send_cmd(f"step{10 * number + place}")
            for number in range(10)
            for place, robot in enumerate(fleet.values())
        ]
        gather(calls).get(timeout=WAIT_S)
    for place, name in enumerate(("r1", "r2", "r3")):
        assert [note.what for note in rig.notes("step", robot=name)] == [str(10 * n + place) for n in range(10)]


def test_a_robot_that_takes_no_batches_gets_none(here: Crowd) -> None:
    robot: Any = here.fleet["r1"]
    robot._actor._channel.process = ""  # as after the handshake of an older release
    gate = hold_calls(here.fleet["r1"])
    calls = [here.fleet["r1"]["Counter"].get_value() for _ in range(5)]
    gate.set()
    gather(calls).get(timeout=WAIT_S)
    assert here.received == [1] * 5


def test_malformed_batches_do_nothing_and_the_robot_serves_on(here: Crowd) -> None:
    robot: Any = here.fleet["r1"]
    controller = robot._actor._controller
    key = controller.call_key("r1", "Counter", "send_cmd")
    row = ("r1", "Counter", "send_cmd", b"", b"")
    bad: list[Any] = [
        pack((PROTOCOL_VERSION, []), "test"),
        pack((PROTOCOL_VERSION, [row] * (MAX_ROWS + 1)), "test"),
        pack((PROTOCOL_VERSION, 7), "test"),
        pack((PROTOCOL_VERSION + 1, [row]), "test"),
        encode_batch([row[:4]]),
        encode_batch([("r1", "Counter", "explode", b"", b"")]),
        encode_batch([("r9", "Counter", "send_cmd", b"", b"")]),
        encode_batch([row]),
    ]
    rng = random.Random(3)  # noqa: S311  # not for secrets
    bad += [b"\x92" + rng.randbytes(rng.randrange(60)) for _ in range(200)]
    for envelope in bad:
        controller._transport.put(key, envelope)
    with contextlib.suppress(ProtocolError):  # the answer to a malformed call goes to all that wait; it is before this
        here.fleet["r1"].release("Counter").get(timeout=WAIT_S)
    assert here.fleet["r1"]["Counter"].send_cmd("step1").get(timeout=WAIT_S) == 1
    assert eventually(lambda: here.counters["r1"][0].steps == ["1"])


def test_a_value_that_takes_no_time_is_read_by_the_thread_that_receives_the_call(here: Crowd) -> None:
    for _ in range(20):
        here.fleet["r1"]["Quick"].get_value().get(timeout=WAIT_S)
        here.fleet["r1"]["Counter"].get_value().get(timeout=WAIT_S)
    counter, quick = here.counters["r1"]
    assert set(counter.readers) == {"r1/Counter"}
    assert f"{here.config.name} server calls" in quick.readers
    for number in range(50):  # what was sent before is seen
        here.fleet["r1"]["Quick"].send_cmd(f"step{number}")
        assert here.fleet["r1"]["Quick"].get_value().get(timeout=WAIT_S).value == number + 1
