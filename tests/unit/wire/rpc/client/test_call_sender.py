"""How far calls run ahead of their answers."""

from __future__ import annotations

import threading

import pytest

from eal_actors.wire.rpc.client import call_sender
from eal_actors.wire.rpc.client.call_sender import WINDOW, InFlightWindow
from tests.net.links import eventually
from tests.robots import WAIT_S


def test_it_waits_for_answers_once_many_are_in_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_sender, "PATIENCE_S", WAIT_S)
    window = InFlightWindow()
    window.calls.update(range(WINDOW - 1))
    assert not window.is_full
    window.calls.add(WINDOW - 1)
    assert window.is_full
    waiting = threading.Thread(target=window.wait_for_room)
    waiting.start()
    assert eventually(lambda: window._resume_at is not None)
    for call in range(WINDOW // 2 - 1):
        window.answered(call)
    assert window._resume_at is not None
    window.answered(WINDOW // 2 - 1)
    waiting.join(WAIT_S / 2)
    assert not waiting.is_alive()
    assert window._slow == 0


def test_what_is_never_answered_holds_nobody_up_for_long() -> None:
    window = InFlightWindow()
    window.calls.update(range(WINDOW))
    window.wait_for_room()  # returns, for no answer comes
    for call in range(WINDOW, 2 * WINDOW - 1):
        window.calls.add(call)
        assert not window.is_full  # what is slow counts no more
    for call in range(2 * WINDOW - 1):
        window.answered(call)
    assert (window.calls, window._slow) == (set(), 0)
