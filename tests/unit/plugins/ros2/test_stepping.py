"""The thread of `eal bridge ros2` that has the dead-man's switches of all robots."""

from __future__ import annotations

import threading

import pytest

from plugins.ros2.bridge import _stepping


class Feed:
    """Counts its steps; a broken one then fails, as for a path of two numbers."""

    def __init__(self, *, is_broken: bool) -> None:
        self.twice = threading.Event()
        self.is_let_go = False
        self._is_broken, self._steps = is_broken, 0

    def step(self) -> None:
        self._steps += 1
        if self._steps > 1:
            self.twice.set()
        if self._is_broken:
            raise ValueError("no path")

    def let_go(self) -> None:
        self.is_let_go = True


def test_a_step_that_fails_ends_no_other(caplog: pytest.LogCaptureFixture) -> None:
    broken, sound = Feed(is_broken=True), Feed(is_broken=False)
    with _stepping([broken, sound], lambda: None):  # type: ignore[list-item]
        assert sound.twice.wait(30)
        assert broken.twice.wait(30)
    assert broken.is_let_go
    assert sound.is_let_go
    assert caplog.text.count("a topic is not served") == 1
