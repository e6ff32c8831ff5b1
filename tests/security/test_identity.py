"""Identity is the certificate's: nobody changes anything for another controller, whatever they know of it.

Each attacker has a real certificate and knows everything about the controller that it imitates: its name, the secret in
its keys, its identifier, its epoch and its last number.
"""

from __future__ import annotations

import random
import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh
from structlog.testing import capture_logs

from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import EALError, ResourceBusyError, StaleCommandError
from eal_actors.wire import session
from eal_actors.wire.format import keys
from eal_actors.wire.format.batches import encode_batch
from eal_actors.wire.format.messages import ACCEPTED, CallHeader, decode_event, encode_call
from tests.net.links import eventually
from tests.net.rig import Rig
from tests.security.forging import Forger, RawClient, Target, make_keys, raw_client, secure_rig

LIVELY_S = 60.0
"""Dead-man's time of tests in which nobody falls silent."""


@pytest.fixture(scope="module")
def keys_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_keys(tmp_path_factory.mktemp("keys"))


@dataclass
class Scene:
    """A robot, a controller that holds its arm and its eye, and others that only have a certificate.

    Attributes:
        holder: the controller.
        others: the attackers by the names of their certificates.
    """

    rig: Rig
    service: RobotService
    holder: RawClient
    others: dict[str, RawClient]

    @property
    def target(self) -> Target:
        """The holder as the attackers know it."""
        holder = self.holder
        return Target(holder.name, holder.secret, holder.id, holder.epoch, holder.sequence)

    def settle(self) -> None:
        """Wait until the robot has handled what the attackers sent; calls of the robot itself wait in a queue."""
        for other in self.others.values():
            other.ping()
        self.holder.call(keys.ROBOT, keys.REATTACH)


@contextmanager
def scene(folder: Path, keys_folder: Path, dead_man_s: float = LIVELY_S) -> Iterator[Scene]:
    rig = secure_rig(folder, keys_folder, dead_man_s)
    with ExitStack() as stack:
        service = stack.enter_context(RobotService(rig.config, "r1"))
        clients = {
            name: stack.enter_context(raw_client(rig.config, name))
            for name in ("controller", "driver", "mate", "display")
        }
        for client in clients.values():
            client.sequence = 0 if client.name == "controller" else 500_000  # no number of a forgery
            client.ping()
        holder = clients.pop("controller")
        assert isinstance(holder.call(keys.ROBOT, keys.HELLO, "controller@desk"), dict)
        assert holder.call("Arm", "send_cmd", "step1") == 1
        yield Scene(rig, service, holder, clients)


@pytest.fixture
def held(tmp_path: Path, keys_folder: Path) -> Iterator[Scene]:
    with scene(tmp_path, keys_folder) as it:
        yield it


def hello(target: Target, epoch: int) -> bytes:
    return encode_call(CallHeader(target.id, epoch, 1, 60.0, 60.0, None, ("controller@desk",)))[0]


# The three attacks of which this is the cure.


@pytest.mark.parametrize("epoch", [2, 999, 2**63])
def test_an_observers_hello_in_anothers_name_makes_no_command_stale(held: Scene, epoch: int) -> None:
    display, target = held.others["display"], held.target
    for name in ("controller", "display"):
        for client in (target.secret, target.id, display.secret):
            display.put(keys.ROBOT, keys.HELLO, hello(target, epoch), name, client)
    held.settle()

    assert [held.holder.call("Arm", "send_cmd", f"step{number}") for number in range(2, 12)] == list(range(2, 12))


def test_heartbeats_in_the_name_of_a_dead_holder_do_not_keep_its_motion_alive(
    tmp_path: Path, keys_folder: Path
) -> None:
    with scene(tmp_path, keys_folder, dead_man_s=1.0) as held:
        target = held.target
        assert held.holder.call("Arm", "send_cmd", "move60") is ACCEPTED

        def goes_on_without_it() -> bool:
            for other in held.others.values():
                for name in (other.name, target.name):
                    for client in (other.secret, target.secret, target.id):
                        other.beat(name, client, target.id)
            return bool(held.service.dead_man_trips)

        assert eventually(goes_on_without_it)
        assert held.service.dead_man_trips == {"Arm": 1}
        assert eventually(lambda: held.rig.notes("halt"))


def test_a_command_with_the_holders_number_does_not_take_what_it_holds(held: Scene) -> None:
    mate, target = held.others["mate"], held.target
    time = mate.time
    for name in ("mate", "controller"):
        for client in (target.secret, target.id, mate.secret):
            header = CallHeader(target.id, 1, 10**5, 60.0, 60.0, None, ("step9",), time.era, time.time_s, 0.0)
            mate.put("Arm", "send_cmd", encode_call(header)[0], name, client)
    assert isinstance(mate.call("Arm", "send_cmd", "step9"), ResourceBusyError)

    assert held.holder.call("Arm", "send_cmd", "step2") == 2
    assert held.rig.steps() == ["1", "2"]


def test_a_leave_in_the_name_of_the_holder_halts_and_frees_nothing(held: Scene) -> None:
    target = held.target
    assert held.holder.call("Arm", "send_cmd", "move60") is ACCEPTED
    for other in held.others.values():
        for method, arguments in ((keys.LEAVE, ()), (keys.RELEASE, ("Arm",)), (keys.CANCEL, (1, target.sequence + 1))):
            for name in (other.name, target.name):
                envelope = encode_call(CallHeader(target.id, 1, 10**5, 60.0, 60.0, None, arguments))[0]
                other.put(keys.ROBOT, method, envelope, name, target.secret)
    held.settle()

    assert held.service.robot["Arm"].get_status().get() == 1
    assert held.holder.ping()["holder_ids"] == {"Arm": target.id}
    assert not held.rig.notes("halt", "end")


def test_without_access_control_the_same_messages_are_believed(
    tmp_path: Path, keys_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The proof that the attacks above are attacks: the same ends, with that check alone left out."""

    def permit_all(*_: object) -> dict[str, Any]:
        return {"enabled": False}

    monkeypatch.setattr(session, "robot_access", permit_all)
    with scene(tmp_path, keys_folder) as held:
        display, target = held.others["display"], held.target
        display.put(keys.ROBOT, keys.LEAVE, hello(target, 1), target.name, target.secret)
        held.settle()
        assert eventually(lambda: held.holder.ping()["holders"] == {})
        display.put(keys.ROBOT, keys.HELLO, hello(target, 900), target.name, target.secret)
        held.settle()
        assert isinstance(held.holder.call("Arm", "send_cmd", "step2"), StaleCommandError)


# Random forgeries.


def check_forgeries(held: Scene, attempts: int, seed: int) -> None:
    """Let the others forge at random while the holder moves and commands; nothing of it may change."""
    chance = random.Random(seed)  # noqa: S311  # no secret
    assert held.holder.call("Arm", "send_cmd", "move60") is ACCEPTED
    before = held.holder.ping()
    assert before["holders"] == {"Arm": "controller@desk"}
    changing = dict.fromkeys(("received_s", "replied_s", "running", "mailboxes"))
    forgers = [Forger(other, held.target, chance) for other in held.others.values()]
    for number in range(attempts):
        forged = forgers[number % len(forgers)].forge()
        if number % 50 == 49 or number == attempts - 1:
            held.settle()
            after = held.holder.ping()
            assert {**after, **changing} == {**before, **changing}, (seed, number, forged)
            assert [row[:3] for row in after["running"]] == [row[:3] for row in before["running"]]
            assert held.service.robot["Arm"].get_status().get() == 1, (seed, number, forged)
            assert not held.rig.notes("halt", "end"), (seed, number, forged)
    assert held.rig.steps() == ["1"]
    assert held.holder.call(keys.ROBOT, keys.CANCEL, 1, forgers[0].target.sequence) == 1
    assert held.holder.call("Arm", "send_cmd", "step2") == 2


def test_random_forgeries_change_nothing(held: Scene) -> None:
    check_forgeries(held, 200, secrets.randbelow(10**6))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_thousand_random_forgeries_change_nothing(held: Scene, seed: int) -> None:
    check_forgeries(held, 1_000, seed)


# What else observers and lesser controllers could use.


def test_a_robot_discloses_no_secret_of_a_controller(held: Scene) -> None:
    """Neither in a ping nor in a handshake nor in its events; identifiers of others are not in a ping either."""
    display, events = held.others["display"], list[bytes]()
    with display.session.declare_subscriber(
        "eal/f/@events/r1", lambda event: events.append(bytes(event.attachment or b""))
    ):
        display.ping()
        assert held.holder.call("Arm", "send_cmd", "move60") is ACCEPTED
        assert eventually(lambda: events)
        ping, shake = display.ping(), display.call(keys.ROBOT, keys.HELLO, "controller@desk")
    assert ping["holders"] == {"Arm": "controller@desk"}
    assert ping["holder_ids"] == {}
    for told in (repr(ping), repr(shake), repr(events)):
        assert held.holder.secret not in told
        assert repr(bytes.fromhex(held.holder.secret)) not in told


def test_nobody_is_shown_under_anothers_name(held: Scene) -> None:
    mate = held.others["mate"]
    mate.beat()
    mate.call(keys.ROBOT, keys.HELLO, "controller@desk")
    held.holder.call(keys.ROBOT, keys.RELEASE, "Arm")
    assert mate.call("Arm", "send_cmd", "step2") == 2

    def is_shown() -> bool:  # a heartbeat may arrive after the handshake, by another thread
        mate.call(keys.ROBOT, keys.HELLO, "controller@desk")
        return bool(held.holder.ping()["holders"] == {"Arm": "mate (controller@desk)"})

    assert eventually(is_shown)


def test_many_processes_of_one_certificate_do_not_push_out_anothers_records(held: Scene) -> None:
    held.holder.call("Arm", "send_cmd", "step2")
    number = held.holder.sequence
    for other in held.others.values():
        for index in range(300):
            client = f"{index:032x}"
            claimed = keys.client_id(other.name, client)
            envelope = encode_call(CallHeader(claimed, 1, 1, 60.0, 60.0, None, ("x",)))[0]
            other.put(keys.ROBOT, keys.HELLO, envelope, None, client)
    held.settle()

    assert held.holder.call(keys.ROBOT, keys.REATTACH, 1, number) == {"running": [], "unknown": []}


def test_streams_of_one_certificate_do_not_use_up_those_of_another(held: Scene) -> None:
    display = held.others["display"]
    refused = [
        answer
        for rate in range(1, 80)
        if isinstance(answer := display.call("Gauge", keys.STREAM, "raw", str(rate), 5000), EALError)
    ]
    assert {answer.code for answer in refused} == {"busy"}
    assert held.holder.call("Gauge", keys.STREAM, "raw", "0.5", 5000) == 1


def test_a_stream_has_few_readers_of_one_certificate(held: Scene) -> None:
    display = held.others["display"]
    answers = [RawClient(display.session, display.name).call("Gauge", keys.STREAM, "raw", "5", 5000) for _ in range(70)]
    refused = [answer for answer in answers if isinstance(answer, EALError)]
    assert [answer.code for answer in refused] == 6 * ["busy"]
    assert held.holder.call("Gauge", keys.STREAM, "raw", "5", 5000) == 1


def test_an_outcome_that_is_asked_for_often_in_one_call_is_published_once(held: Scene) -> None:
    holder = held.holder  # its command has ended
    ended = holder.epoch, holder.sequence
    events: list[bytes] = []
    session = holder.session

    def hear(event: zenoh.Sample) -> None:
        assert event.attachment is not None
        events.append(event.attachment.to_bytes())

    session.declare_subscriber(keys.event_key("f", "r1"), zenoh.handlers.Callback(hear, indirect=False))
    assert holder.call(keys.ROBOT, keys.REATTACH, *(500 * ended)) == {"running": [], "unknown": []}
    holder.ping()
    results = [event for event in map(decode_event, events) if event.kind == "result"]
    assert len(results) == 1


def test_malformed_messages_fill_no_log(held: Scene) -> None:
    with capture_logs() as logs:
        for name, other in held.others.items():
            for number in range(300):
                other.publish(f"eal/f/r1/_/ping/{name}/%{number}", b"")
                other.publish(f"eal/f/@heartbeats/{name}/{number}", bytes([number % 256]))
        held.settle()
    assert {line["source"] for line in logs} == set(held.others)
    assert len(repr(logs)) < 3_000


def test_a_batch_reaches_nothing_that_its_key_does_not(held: Scene) -> None:
    """The key of a batch is one that access control allows; its other rows are not."""
    display = held.others["display"]
    time = display.time

    def row(resource: str, method: str, *arguments: str, robot: str = "r1") -> tuple[str | bytes, ...]:
        display.sequence += 1
        proof = time.era, time.time_s, 0.0
        header = CallHeader(display.id, display.epoch, display.sequence, 60.0, 60.0, None, arguments, *proof)
        return robot, resource, method, encode_call(header)[0], b""

    for forged in (
        row("Arm", "send_cmd", "step66"),
        row("Eye", "set_value"),
        row(keys.ROBOT, keys.STOP, "forged"),
        row(keys.ROBOT, keys.REVOKE, "controller"),
        row("Eye", "get_value", robot="r2"),
    ):
        display.put("Eye", "get_value", encode_batch([row("Eye", "get_value"), forged]))
    held.settle()
    assert "66" not in held.rig.steps()
    assert held.service.robot.stopped_because is None
    assert held.holder.call("Arm", "send_cmd", "step2") == 2
