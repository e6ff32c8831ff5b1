"""How far calls run ahead of their answers."""

from __future__ import annotations

import threading

import pytest

from eal_actors.net import pacing
from eal_actors.net.pacing import WINDOW, Pace
from tests.net.links import eventually
from tests.robots import WAIT_S


def test_it_waits_for_answers_once_many_are_due(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pacing, "PATIENCE_S", WAIT_S)
    pace = Pace()
    for _ in range(WINDOW - 1):
        pace.sent()
    pace.keep()  # at once
    pace.sent()
    waiting = threading.Thread(target=pace.keep)
    waiting.start()
    assert eventually(lambda: pace._is_waiting)
    for _ in range(WINDOW // 2 - 1):
        pace.answered()
    assert pace._is_waiting
    pace.answered()
    waiting.join(WAIT_S / 2)
    assert not waiting.is_alive()
    assert pace._slow == 0


def test_what_is_never_answered_holds_nobody_up_for_long() -> None:
    pace = Pace()
    for _ in range(WINDOW):
        pace.sent()
    pace.keep()  # returns, for no answer comes
    for _ in range(WINDOW - 1):
        pace.sent()
        pace.keep()  # and what is slow counts no more
    for _ in range(2 * WINDOW - 1):
        pace.answered()
    assert (pace._due, pace._slow) == (0, 0)
