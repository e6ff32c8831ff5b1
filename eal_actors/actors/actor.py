"""The base of our actors: a Pykka actor with our inbox, our futures, a thread that can be joined and abandoned."""

from __future__ import annotations

import contextlib
import ctypes
import threading
from typing import Any, ClassVar, Self

import pykka
from pykka.messages import _ActorStop

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.actors.inbox import Action, Inbox
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, UnavailableError, shown
from eal_actors.kernel.log import get_logger


class AbandonedThread(BaseException):
    """Raised inside the thread of a stuck actor that was abandoned, to unwind it."""


class EALActor(pykka.ThreadingActor):
    """A Pykka actor that survives what its messages raise, and whose crash stays its own.

    Subclasses handle their messages in `on_receive`; timers run by themselves. Pykka's loop stops every actor of
    the process when a message raises SystemExit: ours reports a crash of this one actor to `on_crash`.

    Args:
        name: the thread's name.
        clock: the clock of its timers.
        capacity: the most calls that may wait in its mailbox.
    """

    # A stuck handler must not keep the process alive; whoever starts actors stops and joins them.
    use_daemon_thread: ClassVar[bool] = True

    actor_inbox: Inbox  # type: ignore[assignment]  # Pykka's protocol names its own envelope class

    def __init__(self, name: str, clock: Clock, capacity: int = 256) -> None:
        self.name = name
        self.clock = clock
        self._capacity = capacity
        self.thread: threading.Thread | None = None
        self._is_abandoned = False
        super().__init__()

    def _create_actor_inbox(self) -> Inbox:  # type: ignore[override]  # Pykka's is static, but called on the instance
        return Inbox(self.clock, self._capacity)

    @staticmethod
    def _create_future() -> Future[Any]:
        return Future()

    def launch(self) -> Self:
        """Register the actor and start its thread: Pykka's `start` would hide the actor, whose thread we must join."""
        pykka.ActorRegistry.register(self.actor_ref)
        self._start_actor_loop()
        return self

    def end_soon(self) -> None:
        """End, after what is urgent and waits already. Thread: any; does not block."""
        with contextlib.suppress(EALError):  # it has ended
            self.actor_inbox.call_soon(self._stop)

    def _start_actor_loop(self) -> None:
        self.thread = threading.Thread(target=self._actor_loop, name=self.name, daemon=self.use_daemon_thread)
        self.clock.start(self.thread)

    def _actor_loop(self) -> None:
        with contextlib.suppress(AbandonedThread):
            super()._actor_loop()
        if self._is_abandoned:  # also where a plugin swallowed the exception
            self.on_abandoned()

    def _actor_loop_teardown(self) -> None:
        self._refuse(UnavailableError("it has stopped"))

    def _actor_loop_running(self) -> None:
        stopped, inbox = self.actor_stopped, self.actor_inbox
        while not stopped.is_set():
            envelope = inbox.get()
            reply_to = envelope.reply_to
            try:
                response = self._handle_receive(envelope.message)
                if reply_to is not None:
                    reply_to.set(response)
            except AbandonedThread:
                raise
            except BaseException as error:  # noqa: BLE001  # nothing that a message does may pass this line
                if reply_to is not None and isinstance(error, Exception):
                    reply_to.set_exception()
                    continue
                if reply_to is not None:
                    reply_to.set_exception(UnavailableError(f"it crashed: {shown(error)}"))
                self.crash(error)

    def _handle_receive(self, message: Any) -> Any:
        if type(message) is Action:
            action = message.action
            message.action = None
            return action() if action is not None else None
        if isinstance(message, _ActorStop):
            return super()._handle_receive(message)
        return self.on_receive(message)  # Pykka would look first whether a proxy sent it, and there are none

    def crash(self, error: BaseException) -> None:
        """Stop this actor because of an error, and report it. Thread: the actor's own."""
        pykka.ActorRegistry.unregister(self.actor_ref)
        self.actor_stopped.set()
        self._refuse(UnavailableError(f"it crashed: {shown(error)}"))
        try:
            self.on_crash(error)
        except Exception:  # noqa: BLE001  # the crash is reported all the same
            get_logger().exception("cleaning up after a crash failed", actor=self.name)

    def on_crash(self, error: BaseException) -> None:
        """Clean up after a crash and tell whom it concerns. Thread: the actor's own."""

    def on_abandoned(self) -> None:
        """Clean up after `abandon` has unwound what was stuck. Thread: the actor's own."""

    def _refuse(self, error: EALError) -> None:
        """Close the mailbox and fail whatever waits in it."""
        for envelope in self.actor_inbox.close(error):
            message = envelope.message
            if isinstance(message, Call):
                message.fail(error.copy())
            elif isinstance(message, _ActorStop):
                envelope.reply_to.set(None)
            elif envelope.reply_to is not None:
                envelope.reply_to.set_exception(pykka.ActorDeadError(f"{self} stopped before handling the message"))

    def abandon(self, error: EALError) -> None:
        """Give up an actor that is stuck: fail its callers and raise AbandonedThread in its thread.

        Python code that loops or sleeps in turns is unwound by it; a thread that blocks for ever inside one call
        into the operating system stays, as a daemon.

        Thread: any but its own; does not block.
        """
        pykka.ActorRegistry.unregister(self.actor_ref)
        self._is_abandoned = True
        self.actor_stopped.set()
        self._refuse(error)
        if self.thread is not None and self.thread.ident is not None and self.thread.is_alive():
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(self.thread.ident), ctypes.py_object(AbandonedThread)
            )
