"""The base of our actors and its mailbox: a Pykka actor with our inbox, our futures and a thread that can be joined.

Pykka's inboxes are unbounded queues, its actors cannot be joined or abandoned, and a `BaseException` in one of them
stops every actor of the process. All of that is replaced here, through Pykka's own hooks (pinned by
tests/actors/test_pykka_facts.py).

The mailbox has a bounded normal lane, an urgent lane and timers. Urgent messages come first. Then come due timers and
the normal lane; a timer set after the oldest waiting call lets that call go first, so that timers that are always due
cannot starve the calls. Each lane is first in, first out.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar, Final, Protocol, Self

import pykka
from pykka._envelope import Envelope as PykkaEnvelope
from pykka.messages import _ActorStop
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import ROUNDING_S, Clock, Timer, TimerHeap, new_waiter
from eal_actors.kernel.errors import BusyError, EALError, UnavailableError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.unwinding import raise_in

UNWIND_S: Final = 0.5
"""Real time that an abandoned thread has to unwind before another thread halts its resource."""


class Envelope(Protocol):
    """An entry of an inbox: Pykka's envelope, a Call or an Action, which are their own envelopes."""

    @property
    def message(self) -> Any:
        """The message to handle."""
        ...

    @property
    def reply_to(self) -> Any:
        """Pykka's future for the answer, or None."""
        ...


class Action(Timer):
    """A timer in an inbox: its own envelope and its own message."""

    __slots__ = ()

    reply_to = None

    @property
    def message(self) -> Action:
        """The message of this envelope: the action itself."""
        return self


class Inbox:
    """A mailbox for one reading thread and any number of writing ones; see the module.

    `put` never blocks: a full lane raises BusyError at once.

    Args:
        capacity: the most envelopes that may wait in a lane.
    """

    def __init__(self, clock: Clock, capacity: int = 256) -> None:
        self.clock = clock
        self.capacity = capacity
        self._lock = threading.Lock()
        self._wakeup = new_waiter()
        self._reader_waits = False
        self._wakes_at_s = math.inf
        self._borrower: object = None
        self._urgent: deque[Envelope] = deque()
        self._normal: deque[tuple[int, Envelope]] = deque()
        self._timers: TimerHeap[Action] = TimerHeap()
        self._order = itertools.count()
        self._closed_by: EALError | None = None

    def __len__(self) -> int:
        return len(self._urgent) + len(self._normal)

    def empty(self) -> bool:
        """Return whether no envelope waits; timers do not count. Thread: any."""
        return not self._urgent and not self._normal

    def waiting(self) -> list[Envelope]:
        """Return the envelopes that wait, the urgent ones first, without timers. Thread: any; never blocks."""
        with self._lock:
            return self._envelopes()

    def _envelopes(self) -> list[Envelope]:
        return [*self._urgent, *(envelope for _, envelope in self._normal)]

    def put(self, envelope: Envelope) -> None:
        """Add to the normal lane.

        Raises:
            BusyError: the lane is full.
            EALError: the inbox was closed with this error.

        Thread: any; never blocks.
        """
        with self._lock:
            if self._closed_by is not None:
                raise self._closed_by.copy()
            if len(self._normal) >= self.capacity:
                raise BusyError(f"its mailbox is full ({self.capacity} calls wait)")
            self._normal.append((next(self._order), envelope))
            if self._reader_waits:  # as _wake_reader
                self.clock.wake(self._wakeup)
                self._reader_waits = False

    def put_urgent(
        self, envelope: Envelope, *, bounded: bool = True, drop: Callable[[Envelope], bool] | None = None
    ) -> list[Envelope]:
        """Add to the urgent lane.

        Args:
            envelope: the envelope.
            bounded: whether a full lane refuses it; a stop is never refused.
            drop: selects envelopes of the normal lane to take out in the same instant; None for none.

        Returns:
            The envelopes taken out.

        Raises:
            BusyError: the lane is full of calls.
            EALError: the inbox was closed with this error.

        Thread: any; never blocks.
        """
        with self._lock:
            if self._closed_by is not None:
                raise self._closed_by.copy()
            if bounded and len(self._urgent) >= self.capacity and self._count_urgent_calls() >= self.capacity:
                raise BusyError(f"its mailbox is full ({self.capacity} urgent calls wait)")
            dropped: list[Envelope] = []
            if drop is not None and self._normal:
                dropped = [waiting for _, waiting in self._normal if drop(waiting)]
                if dropped:
                    self._normal = deque(entry for entry in self._normal if not drop(entry[1]))
            self._urgent.append(envelope)
            self._wake_reader()
        return dropped

    def _count_urgent_calls(self) -> int:
        """Return how many calls wait in the urgent lane; the actor's own actions do not count."""
        return sum(type(envelope) is not Action for envelope in self._urgent)

    def call_at(self, time_s: float, action: Callable[[], None]) -> Action:
        """Run the action in the reading thread when the clock shows `time_s`. Thread: any; never blocks."""
        with self._lock:
            timer = Action(time_s, next(self._order), action)
            self._timers.add(timer)
            if time_s < self._wakes_at_s:  # otherwise the reader wakes up in time by itself
                self._wake_reader()
        return timer

    def call_soon(self, action: Callable[[], object]) -> None:
        """Run the action in the reading thread before everything that waits; a full lane does not refuse it.

        Raises:
            EALError: the inbox was closed with this error.

        Thread: any; never blocks.
        """
        self.put_urgent(Action(0.0, 0, action), bounded=False)

    def call_later(self, delay_s: float, action: Callable[[], None]) -> Action:
        """Run the action in the reading thread after a delay. Thread: any; never blocks."""
        return self.call_at(self.clock.now() + delay_s, action)

    def get(self) -> Envelope:
        """Wait for the next envelope. Thread: the one reader; blocks it."""
        while True:
            with self._lock:
                self._reader_waits = False
                timer, timeout_s = None, None
                if self._borrower is None:
                    if self._urgent:
                        return self._urgent.popleft()
                    if self._timers.heap and (timer := self._timers.first()) is not None:
                        timeout_s = timer.time_s - self.clock.now()
                        if timeout_s <= ROUNDING_S and not (self._normal and self._normal[0][0] < timer.order):
                            self._timers.pop()
                            return timer
                    if self._normal:
                        return self._normal.popleft()[1]
                self._reader_waits = True
                self._wakes_at_s = math.inf if timer is None else timer.time_s
            self.clock.wait(self._wakeup, timeout_s)

    def borrow(self, borrower: object) -> bool:
        """Take the reader's place while it waits and nothing else does; return whether the caller has it now.

        The reader returns no envelope until `give_back`. Thread: any; never blocks.
        """
        with self._lock:
            if not self._reader_waits or self._borrower is not None or self._urgent or self._normal:
                return False
            if self._wakes_at_s - self.clock.now() <= ROUNDING_S:  # a timer is due
                return False
            self._borrower = borrower
        return True

    def give_back(self, borrower: object) -> None:
        """End `borrow`, if that borrower has the reader's place. Thread: the one that borrowed it; never blocks."""
        with self._lock:
            if self._borrower is borrower:
                self._borrower = None
                timer = self._timers.first()
                if self._urgent or self._normal or (timer is not None and timer.time_s < self._wakes_at_s):
                    self._wake_reader()

    def close(self, error: EALError) -> list[Envelope]:
        """Refuse all further envelopes with the error, the first one given; return those that waited. Thread: any."""
        with self._lock:
            self._closed_by = self._closed_by or error
            waiting = self._envelopes()
            self._urgent.clear()
            self._normal.clear()
            self._timers.clear()
            self._wake_reader()
        return waiting

    def _wake_reader(self) -> None:
        if self._reader_waits:
            self.clock.wake(self._wakeup)  # first: Ctrl-C may strike in between, and one wake-up too many is harmless
            self._reader_waits = False


class AbandonedThread(BaseException):
    """Raised inside the thread of a stuck actor that was abandoned, to unwind it."""


class EALActor(pykka.ThreadingActor):
    """A Pykka actor that survives exceptions in its messages, and whose crash stops no other actor.

    Subclasses handle their messages in `on_receive`; timers run by themselves. Pykka's loop stops every actor of
    the process when a message raises SystemExit; ours reports a crash of this one actor to `on_crash`.

    Args:
        capacity: the most calls that may wait in its mailbox.
    """

    # A stuck handler must not keep the process alive; the code that starts actors stops and joins them.
    use_daemon_thread: ClassVar[bool] = True

    actor_inbox: Inbox  # type: ignore[assignment]  # Pykka's protocol names its own envelope class

    def __init__(self, name: str, clock: Clock, capacity: int = 256) -> None:
        self.name = name
        self.clock = clock
        self._capacity = capacity
        self.thread: threading.Thread | None = None
        self._is_abandoned = False
        super().__init__()

    @override
    def _create_actor_inbox(self) -> Inbox:  # type: ignore[override]  # Pykka's is static, but called on the instance
        return Inbox(self.clock, self._capacity)

    @override
    @staticmethod
    def _create_future() -> Future[Any]:
        return Future()

    def launch(self) -> Self:
        """Register the actor and start its thread. Pykka's `start` would hide the actor, whose thread we must join."""
        pykka.ActorRegistry.register(self.actor_ref)
        self._start_actor_loop()
        return self

    def end_soon(self) -> None:
        """Stop after the urgent messages that wait already. Thread: any; does not block."""
        with contextlib.suppress(EALError):  # it has stopped
            self.actor_inbox.call_soon(self._stop)

    @override
    def _start_actor_loop(self) -> None:
        self.thread = threading.Thread(target=self._actor_loop, name=self.name, daemon=self.use_daemon_thread)
        self.clock.start(self.thread)

    @override
    def _actor_loop(self) -> None:
        with contextlib.suppress(AbandonedThread):
            super()._actor_loop()
        if self._is_abandoned:  # also where a plugin swallowed the exception
            self.on_abandoned()

    @override
    def _actor_loop_teardown(self) -> None:
        self._refuse(UnavailableError("it has stopped"))

    @override
    def _actor_loop_running(self) -> None:
        stopped, inbox = self.actor_stopped, self.actor_inbox
        while not stopped.is_set():
            envelope = inbox.get()
            reply_to = envelope.reply_to
            try:
                is_foreign = type(envelope) is PykkaEnvelope  # ours are their own messages
                response = self._handle_receive(envelope.message if is_foreign else envelope)
                if reply_to is not None:
                    reply_to.set(response)
            except AbandonedThread:
                raise
            except BaseException as error:  # noqa: BLE001  # no exception of a message may pass this line
                if reply_to is not None and isinstance(error, Exception):
                    reply_to.set_exception()
                    continue
                if reply_to is not None:
                    reply_to.set_exception(UnavailableError(f"it crashed: {error_text(error)}"))
                self.crash(error)

    @override
    def _handle_receive(self, message: Any) -> Any:
        if type(message) is Action:
            action = message.action
            message.action = None
            return action() if action is not None else None
        if isinstance(message, _ActorStop):
            return super()._handle_receive(message)
        return self.on_receive(message)  # Pykka would check first whether a proxy sent it, and there are none

    def crash(self, error: BaseException) -> None:
        """Stop this actor because of an error and report it. Thread: the actor's own."""
        pykka.ActorRegistry.unregister(self.actor_ref)
        self.actor_stopped.set()
        self._refuse(UnavailableError(f"it crashed: {error_text(error)}"))
        try:
            self.on_crash(error)
        except Exception:  # noqa: BLE001  # the crash is reported all the same
            get_logger().exception("cleaning up after a crash failed", actor=self.name)

    def on_crash(self, error: BaseException) -> None:
        """Clean up after a crash and report it. Thread: the actor's own."""

    def on_abandoned(self) -> None:
        """Clean up after `abandon` has unwound the stuck code. Thread: the actor's own."""

    def _refuse(self, error: EALError) -> None:
        """Close the mailbox and fail the messages that wait in it."""
        for envelope in self.actor_inbox.close(error):
            message = envelope.message
            if isinstance(message, Future):  # a Call
                message.fail(error.copy())
            elif isinstance(message, _ActorStop):
                envelope.reply_to.set(None)
            elif envelope.reply_to is not None:
                envelope.reply_to.set_exception(pykka.ActorDeadError(f"{self} stopped before handling the message"))

    def abandon(self, error: EALError) -> None:
        """Give up a stuck actor: fail its callers and raise AbandonedThread in its thread.

        That unwinds Python code that loops or sleeps in short turns. A thread that blocks forever inside one system
        call stays, as a daemon.

        Thread: any but its own; does not block.
        """
        pykka.ActorRegistry.unregister(self.actor_ref)
        self._is_abandoned = True
        self.actor_stopped.set()
        self._refuse(error)
        if self.thread is not None:
            raise_in(self.thread, AbandonedThread)


def halt_if_still_stuck(actor: EALActor, halt: Callable[[], Any]) -> None:
    """Halt a resource from a foreign thread if its abandoned actor cannot, which is better than not at all."""
    if actor.thread is not None:
        actor.thread.join(UNWIND_S)
        if actor.thread.is_alive():
            try:
                halt()
            except Exception:  # noqa: BLE001  # a plugin may raise anything
                get_logger(actor=actor.name).exception("last-resort halt failed")
