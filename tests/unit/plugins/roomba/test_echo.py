"""plugins/roomba: the delay of a line by the speeds that the robot reports back."""

from __future__ import annotations

import pytest

from plugins.roomba.echo import CommandEcho


def test_a_command_that_is_shown_tells_the_delay() -> None:
    echo = CommandEcho()
    echo.sent((100, 100), 1.0)
    echo.heard((0, 0), 1.1)
    assert echo.lag_s(1.2) == pytest.approx(0.2)  # it may have grown so far
    echo.heard((100, 100), 1.25)
    assert (echo.delay_s, echo.lag_s(5.0)) == (0.25, 0.25)


def test_a_command_that_was_replaced_need_not_be_shown() -> None:
    echo = CommandEcho()
    echo.sent((100, 100), 1.0)
    echo.sent((50, 50), 1.1)
    echo.heard((50, 50), 1.3)
    assert echo.delay_s == pytest.approx(0.2)
    assert not echo.is_overdue(9.0)


def test_a_command_that_is_not_shown_in_time_is_overdue() -> None:
    echo = CommandEcho()
    echo.sent((100, 100), 0.0)
    echo.heard((100, 100), 0.05)
    echo.sent((0, 0), 1.0)
    echo.heard((100, 100), 1.1)
    assert echo.is_open(1.15)
    assert echo.is_overdue(1.25)
