"""The facts about Pykka that our actors are built on: a new version that changes one must be noticed here."""

from __future__ import annotations

import inspect
import logging
import queue
import threading
from typing import Any

import pykka
import pytest
from pykka import messages


class Plain(pykka.ThreadingActor):
    def __init__(self) -> None:
        super().__init__()
        self.failed = threading.Event()

    def on_receive(self, message: Any) -> Any:
        if isinstance(message, BaseException):
            raise message
        return message

    def on_failure(self, *_: Any) -> None:
        self.failed.set()


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL, logger="pykka")


def test_an_ask_that_raises_raises_at_the_caller_and_the_actor_lives_on() -> None:
    ref = Plain.start()
    with pytest.raises(ValueError, match="no"):
        ref.ask(ValueError("no"), timeout=5)
    assert ref.is_alive()
    assert ref.ask("still here", timeout=5) == "still here"
    ref.stop()


def test_a_tell_that_raises_kills_the_actor_and_runs_on_failure() -> None:
    ref = Plain.start()
    actor = ref._actor_weakref()
    assert actor is not None
    ref.tell(ValueError("no"))
    assert actor.failed.wait(5)
    assert not ref.is_alive()


def test_a_raising_on_start_kills_the_actor_without_on_failure() -> None:
    failed = threading.Event()

    class Broken(pykka.ThreadingActor):
        def on_start(self) -> None:
            raise ValueError("no")

        def on_failure(self, *_: Any) -> None:
            failed.set()

    ref = Broken.start()
    assert ref.actor_stopped.wait(5)
    assert not failed.is_set()


def test_a_base_exception_in_one_actor_stops_every_actor_of_the_process() -> None:
    victim, culprit = Plain.start(), Plain.start()
    culprit.tell(SystemExit(1))
    assert victim.actor_stopped.wait(5)


def test_inboxes_are_unbounded_queues() -> None:
    inbox = Plain._create_actor_inbox()
    assert isinstance(inbox, queue.Queue)
    assert inbox.maxsize == 0


def test_ask_waits_for_ever_unless_told_otherwise() -> None:
    assert inspect.signature(pykka.ActorRef.ask).parameters["timeout"].default is None


def test_futures_have_no_done_callbacks() -> None:
    assert not [name for name in dir(pykka.ThreadingFuture) if "callback" in name]


def test_threads_are_not_daemons() -> None:
    assert pykka.ThreadingActor.use_daemon_thread is False


def test_messages_pass_by_reference() -> None:
    ref = Plain.start()
    message = [1]
    assert ref.ask(message, timeout=5) is message
    ref.stop()


@pytest.mark.parametrize(
    "name",
    [
        "_actor_loop",
        "_actor_loop_running",
        "_actor_loop_teardown",
        "_create_actor_inbox",
        "_create_future",
        "_handle_receive",
        "_start_actor_loop",
        "_stop",
    ],
)
def test_what_we_override_or_call_is_there(name: str) -> None:
    assert callable(getattr(pykka.ThreadingActor, name))


def test_the_stop_message_and_the_envelope_are_what_our_inbox_expects() -> None:
    from pykka._envelope import Envelope

    assert inspect.isclass(messages._ActorStop)
    envelope = Envelope("message")
    assert (envelope.message, envelope.reply_to) == ("message", None)


def test_map_and_friends_make_their_future_by_calling_its_class() -> None:
    source = inspect.getsource(pykka.Future.map)
    assert "self.__class__()" in source
