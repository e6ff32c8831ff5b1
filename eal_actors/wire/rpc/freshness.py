"""Freshness and deduplication of commands: each command runs at most once and never late.

A robot that was frozen, or whose link stalled, reads old commands from its sockets when it continues, and its clock is
not synchronised with its controller's. So every command carries a stamp: the last reading of the robot's own clock
that the controller received (the echo), and the time since then. At their sum, by the robot's own clock, or later, the
command was sent. Hence

    age  <=  now - (echo + held x (1 - MAX_DRIFT))

whatever the offset of the clocks. The bound exceeds the true age by the time that the echo took to the controller, so
a fresh command is refused only if its time to live is shorter than the round trip. No freeze has to be detected.

Guarantees, if the clocks drift by at most MAX_DRIFT against each other. `CommandHistory.accept` refuses every command
- that was sent longer ago than its time to live,
- that was stamped for an earlier run of the robot's server: each run has another era,
- that was accepted before,
- that was overtaken, by a later command of the same client to the same resource, or by a reconnect of that client: a
  command that a client gave up with a connection does not run afterwards,
- whose stamp contains a NaN.

Memory is bounded. Outcomes of old commands are forgotten one by one, so late that a controller can still ask for all
that it waits for: it may have a full mailbox of commands for each resource, and asks a second or more after a reply was
lost. When there are too many in all, the certificate with most of them loses its oldest. Whole clients are forgotten
when too many others were heard more recently: first those of the certificate with most clients, so that nobody's
clients push out another's. Of an unknown client, only commands pass that were sent after the robot last heard any
client that it has forgotten.

Limits:
- A clock must run while its process is frozen. The system's monotonic clock does, but not while the machine sleeps:
  commands that waited through a sleep of the robot look as young as before it.
- An accepted command may wait in a mailbox: begin it no later than its time to live after its sending.
- Halts and stops are obeyed at any age and any number of times.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Generic, NoReturn, TypeVar

from eal_actors.kernel.errors import StaleCommandError, UnavailableError
from eal_actors.wire.format.keys import certificate_id
from eal_actors.wire.format.messages import CallHeader, CallId

T = TypeVar("T")

MAX_DRIFT: Final = 500e-6
"""Drift of two clocks against each other, in seconds per second; quartz clocks stay well below."""

_ROUNDING_S: Final = 1e-3
"""Tolerance for a sending time ahead of the robot's clock, for rounding."""

_RENEWAL_S: Final = 10.0
"""Age at which any newer echo replaces an echo, so that none from before a jump of a clock is kept for ever."""

_EPOCH_AT: Final = 64
"""Bits of a sequence number, which a message cannot exceed."""


class Stamper:
    """Numbers and stamps the commands of one client to one robot. Thread: one at a time, except `number` and `heard`.

    Times are the controller's clock in seconds. Commands to a resource must be sent in the order of their stamps.
    `epoch` is the number of the connection to the robot. `number` returns the number of the next call, for calls that
    are no commands.
    """

    def __init__(self, client: str) -> None:
        self.client: Final = client
        self.epoch = 0
        self.number: Final[Callable[[], int]] = itertools.count(1).__next__
        self._echo: tuple[str, float, float] | None = None  # replaced as a whole: whichever is kept is a true bound

    def reconnect(self) -> None:
        """Begin a new epoch: once the robot knows it (`CommandHistory.enter`), it refuses earlier commands."""
        self.epoch += 1

    def heard(self, era: str, robot_s: float, now_s: float) -> None:
        """Note the robot's clock from a reply or an event of a run of its server; the most precise echo is kept.

        The robot has read its clock before it sent the reply, the controller reads its own after the reply arrived.
        Thread: any.
        """
        if self._echo is not None:
            known, echo_s, came_s = self._echo
            held_s = now_s - came_s
            if era == known and held_s < _RENEWAL_S and robot_s < echo_s + held_s * (1 - MAX_DRIFT):
                return
        self._echo = era, robot_s, now_s

    def stamp(self, now_s: float) -> tuple[int, str, float, float]:
        """Return the number of the next command and its stamp: era, echo_s and held_s; see CallHeader.

        `now_s` is read before sending. Raises UnavailableError if the robot has not replied yet, so there is no echo.
        """
        if self._echo is None:
            raise UnavailableError("the robot has not answered yet: without its clock no command can be sent")
        era, echo_s, came_s = self._echo
        return self.number(), era, echo_s, max(now_s - came_s, 0.0)  # an echo may come after that reading


@dataclass(frozen=True, slots=True)
class CommandRecord(Generic[T]):
    """Record of an accepted command, with its outcome once it has ended."""

    is_finished: bool
    outcome: T | None = None


@dataclass(slots=True)
class _ClientHistory(Generic[T]):
    """Records of one client.

    Attributes:
        sent_after_s: commands sent until then may have been accepted and forgotten.
        epoch: its latest epoch.
        heard_s: upper bound of the sending times of its accepted messages.
        number: the greatest sequence number accepted in any epoch.
        latest: the sequence number last accepted in this epoch, by resource.
        running: accepted commands that have not ended, by epoch and sequence number in one int: thousands of outcomes
            are kept, and the garbage collector goes through tuples, but not through ints.
        outcomes: outcomes of those that have, in the order of ending.
    """

    sent_after_s: float
    epoch: int
    heard_s: float = -math.inf
    number: int = 0
    latest: dict[str, int] = field(default_factory=dict)
    running: set[int] = field(default_factory=set)
    outcomes: OrderedDict[int, T] = field(default_factory=OrderedDict)


class CommandHistory(Generic[T]):
    """Accepts each command of a robot once and in time, and records the last outcomes, of type T.

    Times are the robot's clock in seconds, and do not decrease from call to call. Names of resources must be checked by
    the caller, since each client has one entry for each name. Thread: one at a time.

    Args:
        era: identifier of this run of the robot's server.
        outcomes: number of outcomes kept for each client, 1 or more, and for all together `outcomes_in_all`.
        clients: number of clients kept, from 1 to `outcomes_in_all`.
    """

    def __init__(self, era: str, *, outcomes: int = 1024, clients: int = 256, outcomes_in_all: int = 4096) -> None:
        self.era: Final = era
        self._max_outcomes: Final = outcomes
        self._max_clients: Final = clients
        self._max_outcomes_in_all: Final = outcomes_in_all
        self._outcomes = 0
        self._clients: OrderedDict[str, _ClientHistory[T]] = OrderedDict()
        self._sent_after_s = -math.inf

    def enter(self, client: str, epoch: int, now_s: float) -> None:
        """Note that a client has reconnected: its commands of earlier epochs are refused from now on."""
        history = self._clients.get(client) or _ClientHistory[T](self._sent_after_s, epoch)
        self._note(history, client, epoch, now_s)

    def accept(self, header: CallHeader, resource: str, now_s: float) -> float:
        """Accept a command, and return the earliest time of its sending; call `finish` when it has ended.

        `now_s` is read after the command arrived. Raises StaleCommandError if it is too old, was overtaken, or was
        accepted before; then nothing changes.
        """
        client, epoch, sequence, ttl_s, _, _, _, era, echo_s, held_s, _ = header
        sent_s = echo_s + held_s * (1 - MAX_DRIFT)
        if era != self.era or not -_ROUNDING_S <= now_s - sent_s <= ttl_s:
            self._refuse(header, resource, now_s - sent_s)
        history = self._clients.get(client)
        if history is None:
            history = _ClientHistory[T](self._sent_after_s, epoch, number=sequence)
        if epoch != history.epoch or sequence <= history.number or sent_s <= history.sent_after_s:
            _check_order(history, header, resource, sent_s)
            history.number = max(history.number, sequence)
            self._note(history, client, epoch, max(now_s, sent_s))
        else:  # it is the client's newest call of all, as usual: it was neither accepted before nor overtaken
            history.number = sequence
            heard_s = max(now_s, sent_s)
            if heard_s > history.heard_s:  # as _note
                history.heard_s = heard_s
            self._clients.move_to_end(client)
        history.latest[resource] = sequence
        history.running.add(epoch << _EPOCH_AT | sequence)
        return sent_s

    def finish(self, call: CallId, outcome: T) -> None:
        """Record the outcome of an accepted command; ignored if its client was forgotten meanwhile."""
        client, epoch, sequence = call
        history, number = self._clients.get(client), epoch << _EPOCH_AT | sequence
        if history is None or number not in history.running:
            return
        history.running.remove(number)
        history.outcomes[number] = outcome
        self._outcomes += 1
        if self._outcomes > self._max_outcomes_in_all:
            history = self._most_outcomes()
        elif len(history.outcomes) <= self._max_outcomes:
            return
        history.outcomes.popitem(last=False)
        self._outcomes -= 1

    def replace(self, call: CallId, outcome: T) -> None:
        """Replace the kept outcome of a command, if there is one."""
        history = self._clients.get(call.client)
        if history is not None and (number := _number_of(call)) in history.outcomes:
            history.outcomes[number] = outcome

    def _most_outcomes(self) -> _ClientHistory[T]:
        """Return the client with most outcomes, of the certificate with most of them."""
        counts = Counter[str]()
        for client, history in self._clients.items():
            counts[certificate_id(client)] += len(history.outcomes)
        ((most, _),) = counts.most_common(1)
        histories = (history for client, history in self._clients.items() if certificate_id(client) == most)
        return max(histories, key=lambda history: len(history.outcomes))

    def recall(self, call: CallId) -> CommandRecord[T] | None:
        """Return the record of a command; None if it was never accepted or is forgotten."""
        history = self._clients.get(call.client)
        if history is None:
            return None
        number = _number_of(call)
        if number in history.running:
            return CommandRecord(False)
        return CommandRecord(True, history.outcomes[number]) if number in history.outcomes else None

    def _refuse(self, header: CallHeader, resource: str, age_s: float) -> NoReturn:
        """Raise StaleCommandError for a command of another run or of a wrong age."""
        if header.era != self.era:
            why = f"was meant for run {header.era} of the robot's server; this is run {self.era}"
            raise _stale(header, resource, f"{why}: it was restarted meanwhile")
        if age_s < -_ROUNDING_S:
            raise _stale(
                header,
                resource,
                f"seems to be sent in {-age_s:.3f} s: the robot's clock is slower than the controller's",
            )
        raise _stale(header, resource, f"was sent up to {age_s:.3f} s ago, and may be {header.ttl_s:.3f} s old at most")

    def _note(self, history: _ClientHistory[T], client: str, epoch: int, heard_s: float) -> None:
        """Make a client the most recent one, and forget another if there are too many."""
        if epoch > history.epoch:
            history.epoch = epoch
            history.latest.clear()
        if heard_s > history.heard_s:
            history.heard_s = heard_s
        clients = self._clients
        clients[client] = history
        clients.move_to_end(client)
        if len(clients) > self._max_clients:
            self._forget_one()

    def _forget_one(self) -> None:
        """Forget the least recent client of the certificate with most clients, preferably an idle one."""
        counts = Counter(map(certificate_id, self._clients))
        most = max(counts.values())
        others = [client for client in list(self._clients)[:-1] if counts[certificate_id(client)] == most]
        name = next((other for other in others if not self._clients[other].running), others[0])
        forgotten = self._clients.pop(name)
        self._outcomes -= len(forgotten.outcomes)
        self._sent_after_s = max(self._sent_after_s, forgotten.heard_s)


def _number_of(call: CallId) -> int:
    return call.epoch << _EPOCH_AT | call.sequence


def _check_order(history: _ClientHistory[T], header: CallHeader, resource: str, sent_s: float) -> None:
    epoch, sequence = header.epoch, header.sequence
    if sent_s <= history.sent_after_s:
        raise _stale(header, resource, "was sent at a time of which the robot has forgotten whom it heard")
    if epoch < history.epoch:
        raise _stale(header, resource, f"was sent before the controller's reconnect number {history.epoch}")
    if (number := _number_of(header.call_id)) in history.running or number in history.outcomes:
        raise _stale(header, resource, "was accepted before")
    if epoch == history.epoch and sequence <= history.latest.get(resource, -1):
        raise _stale(header, resource, f"comes after number {history.latest[resource]} was accepted")


def _stale(header: CallHeader, resource: str, why: str) -> StaleCommandError:
    client, epoch, sequence = header.call_id
    return StaleCommandError(f"command {sequence} (epoch {epoch}) of controller {client} {why}", resource=resource)
