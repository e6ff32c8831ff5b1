"""The base of our actors: a Pykka actor with our inbox, our futures and a thread that can be joined.

Pykka's inboxes are unbounded queues, its actors cannot be joined or abandoned, and a `BaseException` in one of them
stops every actor of the process. All of that is replaced here, through Pykka's own hooks (pinned by
tests/actors/test_pykka_facts.py).
"""

from __future__ import annotations

import contextlib
import contextvars
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Final, Self

import pykka
from pykka._envelope import Envelope as PykkaEnvelope
from pykka.messages import _ActorStop
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.actors.inbox import Action, Inbox
from eal_actors.device.plugin_context import crash_text
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.unwinding import AbandonedThread, raise_in

UNWIND_S: Final = 0.5
"""Real time that an abandoned thread has to unwind before another thread halts its resource."""


class EALActor(pykka.ThreadingActor):
    """A Pykka actor that survives exceptions in its messages, and whose crash stops no other actor.

    Subclasses handle their messages in `on_receive`; timers run by themselves. Pykka's loop stops every actor of the
    process when a message raises SystemExit; ours reports a crash of this one actor to `on_crash`. `capacity` is the
    most calls that may wait in its mailbox.
    """

    # A stuck handler must not keep the process alive; the code that starts actors stops and joins them.
    use_daemon_thread: ClassVar[bool] = True

    _context: contextvars.Context
    """Of its thread, for code that other threads run in its place; set by a subclass that allows that."""

    actor_inbox: Inbox  # type: ignore[assignment]  # Pykka's protocol names its own envelope class

    def __init__(self, name: str, clock: Clock, capacity: int = 256) -> None:
        self.name = name
        self.clock = clock
        self._capacity = capacity
        self.thread: threading.Thread | None = None
        self._is_abandoned = False
        self._visitor: threading.Thread | None = None
        self._visitor_lock = threading.Lock()
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

    def run_soon(self, action: Callable[[], object]) -> None:
        """Run an action after the urgent messages that wait; discard it if stopped. Thread: any; never blocks."""
        try:
            self.actor_inbox.call_soon(action)
        except EALError:
            get_logger().debug("an actor has stopped; an action is discarded", actor=self.name)

    def end_soon(self) -> None:
        """Stop after the urgent messages that wait already. Thread: any; never blocks."""
        self.run_soon(self._stop)

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
                if type(envelope) is Action:
                    envelope.run()
                    continue
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
                    reply_to.set_exception(UnavailableError(f"it crashed: {crash_text(error)}"))
                self.crash(error)

    @override
    def _handle_receive(self, message: Any) -> Any:
        if isinstance(message, _ActorStop):
            return super()._handle_receive(message)
        return self.on_receive(message)  # Pykka would check first whether a proxy sent it, and there are none

    def serve_now(self, message: Any) -> bool:
        """Handle a message in the caller's thread, in this actor's place, if the actor is idle; else return False.

        The mailbox's order holds: the actor is idle when nothing waits and no timer is due, and handles nothing else
        until the message is handled. Thread: any.
        """
        inbox = self.actor_inbox
        try:
            if not inbox.borrow(message):
                return False
            self._run_here(self._handle_receive, message)
        finally:
            inbox.give_back(message)
        return True

    def serve_timers(self) -> float:
        """Run the due timers in the caller's thread, as `serve_now` does; return the time of the next. Thread: any."""
        inbox, visit = self.actor_inbox, object()
        while (timer := inbox.borrow_timer(visit)) is not None:
            try:
                self._serve_timer(timer)
            finally:
                inbox.give_back(visit)
        return inbox.set_reader_time()

    def _serve_timer(self, timer: Action) -> None:
        """Run a timer. Thread: another actor's, which lives on if this actor is abandoned meanwhile."""
        try:
            with self._visitor_lock:
                self._visitor = threading.current_thread()
            try:
                self._run_here(timer.run)
            finally:
                with self._visitor_lock:  # from here on, `abandon` does not raise in this thread
                    self._visitor = None
        except AbandonedThread:
            if not self._is_abandoned:
                raise

    def _run_here(self, handle: Callable[..., object], *arguments: object) -> None:
        try:
            self._context.run(handle, *arguments)
        except (KeyboardInterrupt, AbandonedThread):  # they are meant for the caller
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything, which crashes its actor alone
            self.run_soon(partial(self.crash, error))

    def crash(self, error: BaseException) -> None:
        """Stop this actor because of an error and report it. Thread: the actor's own."""
        pykka.ActorRegistry.unregister(self.actor_ref)
        self.actor_stopped.set()
        self._refuse(UnavailableError(f"it crashed: {crash_text(error)}"))
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
        """Give up a stuck actor: fail its callers and raise AbandonedThread in its thread, and in one that serves it.

        That unwinds Python code that loops or sleeps in short turns. A thread that blocks forever inside one system
        call stays, as a daemon. Thread: any but its own; does not block.
        """
        pykka.ActorRegistry.unregister(self.actor_ref)
        self._is_abandoned = True
        self.actor_stopped.set()
        self._refuse(error)
        if self.thread is not None:
            raise_in(self.thread, AbandonedThread)
        with self._visitor_lock:
            if self._visitor is not None:
                raise_in(self._visitor, AbandonedThread)


def halt_if_still_stuck(actor: EALActor, halt: Callable[[], Any]) -> None:
    """Halt a resource from a foreign thread if its abandoned actor cannot, which is better than not at all."""
    if actor.thread is not None:
        actor.thread.join(UNWIND_S)
        if actor.thread.is_alive():
            try:
                halt()
            except Exception:  # noqa: BLE001  # a plugin may raise anything
                get_logger(actor=actor.name).exception("last-resort halt failed")
