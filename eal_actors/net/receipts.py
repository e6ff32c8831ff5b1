"""At most once and never late: what proves that a command is fresh, and what a robot remembers of commands.

A robot that was frozen, or whose link stalled, reads old commands from its sockets when it goes on; and its clock has
nothing to do with its controller's. So every command carries a `Stamp`: the last time the robot's own clock was seen
in an answer (the echo), and for how long the controller has had that echo. The robot adds the two: at that time of its
own clock, or later, the command was sent. Hence

    age  <=  now - (echo + held x (1 - MAX_DRIFT))

whatever the offset of the clocks. The bound exceeds the true age by the time the echo took to the controller: a command
is refused without need only if its time to live is shorter than the round trip. Nobody has to notice a freeze for this.

Guarantees, as long as the clocks drift by at most MAX_DRIFT against each other. `Receipts.accept` passes no command
- that was sent longer ago than its time to live,
- that was stamped for an earlier run of the robot's server: each run has another era,
- that was accepted before,
- that was overtaken: by a later command of the same client to the same resource, or by a reconnect of that client. What
  a client has given up as lost with a connection does not run afterwards,
- whose stamp holds what is not a number.

This holds with bounded memory. The outcomes of old commands are forgotten one by one, and whole clients when too many
others were heard more lately; of a client that is not known, or no longer, only those commands pass that were sent
after the robot last heard anybody whom it has forgotten.

Limits:
- A clock must go on while its process is frozen. The system's monotonic clock does, but not while the whole machine
  sleeps: commands that waited through a sleep of the robot look as young as before it.
- A command that is accepted may wait in a mailbox: begin it only until its stamp's `begin_by_s`.
- Halts and stops do not come here: they are obeyed however old, and however often they arrive.
"""

from __future__ import annotations

import itertools
import math
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final, Generic, NamedTuple, TypeVar

from eal_actors.kernel.errors import StaleCommandError, UnavailableError
from eal_actors.net.offset import MAX_DRIFT
from eal_actors.net.wire import CallId

T = TypeVar("T")

_ROUNDING_S: Final = 1e-3
"""How far ahead of the robot's clock a sending may seem to be: rounding, and no time to any command."""

_RENEWAL_S: Final = 10.0
"""An echo this old makes way for any newer one, lest one from before a jump of a clock be kept for ever."""


class Stamp(NamedTuple):
    """What a command carries to prove that it is fresh.

    Attributes:
        call: which command.
        ttl_s: how old it may be when it begins, in seconds.
        era: the run of the robot's server that the echo is from.
        echo_s: a reading of the robot's clock, as an answer of the robot brought it.
        held_s: seconds by the controller's clock from the arrival of that answer to the sending of the command.
    """

    call: CallId
    ttl_s: float
    era: str
    echo_s: float
    held_s: float

    @property
    def sent_s(self) -> float:
        """The robot's time at which the command was sent, or earlier; relative deadlines count from it."""
        return self.echo_s + self.held_s * (1 - MAX_DRIFT)

    @property
    def begin_by_s(self) -> float:
        """The robot's time after which the command must not begin any more."""
        return self.sent_s + self.ttl_s


class Stamper:
    """The controller's side: numbers and stamps the commands to one robot.

    Times are the controller's clock in seconds, and do not decrease from call to call. Commands to a resource must be
    sent in the order of their stamps.

    Args:
        client: 16 hexadecimal digits, new in each process of a controller.

    Thread: one at a time.
    """

    def __init__(self, client: str) -> None:
        self.client: Final = client
        self.epoch = 0
        self._numbers = itertools.count(1)
        self._era: str | None = None
        self._echo_s = 0.0
        self._came_s = 0.0

    def number(self) -> int:
        """Return the number of the next call; commands have theirs from `stamp`. Thread: any."""
        return next(self._numbers)

    def reconnect(self) -> None:
        """Begin a new epoch: once the robot knows of it (`Receipts.enter`), it refuses what is still under way."""
        self.epoch += 1

    def heard(self, era: str, robot_s: float, now_s: float) -> None:
        """Take in the robot's clock, from any answer or event: whichever tells most is kept.

        Args:
            era: the run of the robot's server.
            robot_s: the robot's clock, read before the answer left.
            now_s: the controller's clock, read after the answer came.
        """
        held_s = now_s - self._came_s
        if era != self._era or held_s >= _RENEWAL_S or robot_s >= self._echo_s + held_s * (1 - MAX_DRIFT):
            self._era, self._echo_s, self._came_s = era, robot_s, now_s

    def stamp(self, ttl_s: float, now_s: float) -> Stamp:
        """Return the stamp of the next command.

        Args:
            ttl_s: how old it may be when it begins; longer than the round trip.
            now_s: the controller's clock, read before the command leaves.

        Raises:
            UnavailableError: the robot has not answered yet, so that nothing can prove a command fresh.
        """
        if self._era is None:
            raise UnavailableError("the robot has not answered yet: without its clock no command can be sent")
        call = CallId(self.client, self.epoch, self.number())
        return Stamp(call, ttl_s, self._era, self._echo_s, now_s - self._came_s)


@dataclass(frozen=True, slots=True)
class Receipt(Generic[T]):
    """What is remembered of an accepted command.

    Attributes:
        is_finished: whether it has ended.
        outcome: its outcome once it has ended, else None.
    """

    is_finished: bool
    outcome: T | None = None


@dataclass(slots=True)
class _Client(Generic[T]):
    """What is remembered of one client.

    Attributes:
        sent_after_s: commands sent until then may be some that were forgotten.
        epoch: its latest epoch.
        heard_s: nothing that it sent and that was taken in was sent later.
        latest: the sequence number last accepted in this epoch, by resource.
        running: accepted commands that have not ended.
        outcomes: those that have, by their order of ending.
    """

    sent_after_s: float
    epoch: int
    heard_s: float = -math.inf
    latest: dict[str, int] = field(default_factory=dict)
    running: set[CallId] = field(default_factory=set)
    outcomes: OrderedDict[CallId, T] = field(default_factory=OrderedDict)


class Receipts(Generic[T]):
    """The robot's side: lets a command pass once and in time, and remembers how the last ones ended.

    Times are the robot's clock in seconds, and do not decrease from call to call. The names of resources must be
    checked before: each client may fill one entry for each. The type argument is what an outcome is.

    Args:
        era: names this run of the robot's server; no other run has the same.
        outcomes: how many ended commands to remember of each client, 1 or more.
        clients: how many clients to remember, 1 or more.

    Thread: one at a time.
    """

    def __init__(self, era: str, *, outcomes: int = 64, clients: int = 256) -> None:
        self.era: Final = era
        self._max_outcomes: Final = outcomes
        self._max_clients: Final = clients
        self._clients: OrderedDict[str, _Client[T]] = OrderedDict()
        self._sent_after_s = -math.inf

    def enter(self, client: str, epoch: int, now_s: float) -> None:
        """Take note that a client has connected anew: commands of its earlier epochs are refused from now on."""
        memory = self._clients.get(client)
        if memory is None:
            memory = _Client[T](self._sent_after_s, epoch)
        self._note(memory, client, epoch, now_s)

    def accept(self, stamp: Stamp, resource: str, now_s: float) -> None:
        """Let a command pass, once; each one that passes must be finished later.

        Args:
            stamp: what it carries.
            resource: name of the resource that it commands.
            now_s: the robot's clock, read after the command was taken from the link.

        Raises:
            StaleCommandError: it is too old or comes too late, or was accepted before. Nothing is changed.
        """
        self._check_age(stamp, resource, now_s)
        client, epoch, sequence = stamp.call
        memory = self._clients.get(client)
        if memory is None:
            memory = _Client[T](self._sent_after_s, epoch)
        _check_order(memory, stamp, resource)
        self._note(memory, client, epoch, max(now_s, stamp.sent_s))
        memory.latest[resource] = sequence
        memory.running.add(stamp.call)

    def finish(self, call: CallId, outcome: T) -> None:
        """Remember how an accepted command ended. Of a client forgotten meanwhile nothing is remembered."""
        memory = self._clients.get(call.client)
        if memory is None or call not in memory.running:
            return
        memory.running.remove(call)
        memory.outcomes[call] = outcome
        if len(memory.outcomes) > self._max_outcomes:
            memory.outcomes.popitem(last=False)

    def recall(self, call: CallId) -> Receipt[T] | None:
        """Return what is remembered of a command; None if it was never accepted, or is forgotten."""
        memory = self._clients.get(call.client)
        if memory is None:
            return None
        if call in memory.running:
            return Receipt(False)
        return Receipt(True, memory.outcomes[call]) if call in memory.outcomes else None

    def _check_age(self, stamp: Stamp, resource: str, now_s: float) -> None:
        if stamp.era != self.era:
            raise _stale(stamp, resource, f"was meant for run {stamp.era} of the robot's server; this is {self.era}")
        age_s = now_s - stamp.sent_s
        if age_s < -_ROUNDING_S:
            raise _stale(
                stamp,
                resource,
                f"seems to be sent in {-age_s:.3f} s: the robot's clock is slower than the controller's",
            )
        if not age_s <= stamp.ttl_s:  # in this form it refuses what is not a number, too
            raise _stale(
                stamp, resource, f"was sent up to {age_s:.3f} s ago, and may be {stamp.ttl_s:.3f} s old at most"
            )

    def _note(self, memory: _Client[T], client: str, epoch: int, heard_s: float) -> None:
        """Make a client the one heard last, and forget another if that makes one too many."""
        if epoch > memory.epoch:
            memory.epoch = epoch
            memory.latest.clear()
        memory.heard_s = max(memory.heard_s, heard_s)
        self._clients[client] = memory
        self._clients.move_to_end(client)
        if len(self._clients) > self._max_clients:
            self._forget_one()

    def _forget_one(self) -> None:
        """Forget the client that was heard least lately, if possible one that waits for no outcome."""
        others = list(self._clients)[:-1]
        name = next((other for other in others if not self._clients[other].running), others[0])
        self._sent_after_s = max(self._sent_after_s, self._clients.pop(name).heard_s)


def _check_order(memory: _Client[T], stamp: Stamp, resource: str) -> None:
    _, epoch, sequence = stamp.call
    if stamp.sent_s <= memory.sent_after_s:
        raise _stale(stamp, resource, "was sent at a time of which the robot has forgotten whom it heard")
    if epoch < memory.epoch:
        raise _stale(stamp, resource, f"was sent before the controller's reconnect number {memory.epoch}")
    if stamp.call in memory.running or stamp.call in memory.outcomes:
        raise _stale(stamp, resource, "was accepted before")
    if epoch == memory.epoch and sequence <= memory.latest.get(resource, -1):
        raise _stale(stamp, resource, f"comes after number {memory.latest[resource]} was accepted")


def _stale(stamp: Stamp, resource: str, why: str) -> StaleCommandError:
    client, epoch, sequence = stamp.call
    return StaleCommandError(f"command {sequence} (epoch {epoch}) of controller {client} {why}", resource=resource)
