"""plugins/roomba: commands, byte by byte."""

from __future__ import annotations

import pytest

from eal_actors.kernel.errors import ArgumentError
from plugins.roomba import oi
from plugins.roomba.oi import OiLights


def test_commands_on_the_wire() -> None:
    assert list(oi.drive_direct(-200, 300)) == [145, 1, 44, 255, 56]  # the right wheel comes first
    assert list(oi.stream([29, 13])) == [148, 2, 29, 13]  # the document's example
    assert [list(oi.stream_on(on=on)) for on in (False, True)] == [[150, 0], [150, 1]]
    assert list(OiLights(dock=True, power_intensity=128).encode()) == [139, 4, 0, 128]  # the document's example


def test_an_encoder_counts_508_times_a_turn_of_a_wheel_of_72_mm() -> None:
    assert pytest.approx(0.00044456, abs=1e-8) == oi.METRES_A_COUNT


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: oi.drive_direct(501, 0), "the left wheel's speed in mm/s must be -500..500, not 501"),
        (lambda: oi.drive_direct(0, -501), "the right wheel's speed"),
        (lambda: OiLights(power_colour=256).encode(), "power light's colour must be 0..255, not 256"),
        (lambda: OiLights(power_intensity=-1).encode(), "intensity"),
        (lambda: oi.stream([6, 60]), "no sensor packet 60"),
        (lambda: oi.stream([7] * 256), "a list has 255 packets at most, not 256"),
    ],
)
def test_what_the_wire_cannot_carry_is_refused(call: object, words: str) -> None:
    assert callable(call)
    with pytest.raises(ArgumentError, match=words):
        call()
