"""Driving by a gamepad's stream of bytes through a pipe, with the dead-man's ends."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.operate.hands import HandDriver, HandSettings, InputSource, find_input
from tests.operate.dashboard.rig import counting_fleet, resource_of, wait_for
from tests.operate.hands.test_sticks import ABS_Y, BTN_TR, EV_ABS, EV_KEY, event

START = 0x13B
FULL = event(EV_ABS, ABS_Y, -32768)
HELD, LET_GO = event(EV_KEY, BTN_TR, 1), event(EV_KEY, BTN_TR, 0)


class Hand:
    """A hand on a gamepad whose cable is a pipe."""

    def __init__(self, fleet: Fleet, settings: HandSettings) -> None:
        read, self._write = os.pipe()
        os.set_blocking(read, False)
        self.source = InputSource("pipe", read, {})
        self.lines: list[str] = []
        self.error: EALError | None = None
        self._driver = HandDriver(fleet, ["one", "two"], settings, self.lines.append)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._driver.run(self.source)
        except EALError as error:
            self.error = error

    def send(self, *events: bytes) -> None:
        os.write(self._write, b"".join(events))

    def unplug(self) -> None:
        if self._write >= 0:
            os.close(self._write)
            self._write = -1
        self._thread.join(60)
        assert not self._thread.is_alive()


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    with counting_fleet(tmp_path, "one", "two").connect() as opened:
        yield opened


@pytest.fixture
def hand(fleet: Fleet) -> Iterator[Callable[..., Hand]]:
    hands: list[Hand] = []

    def make(**settings: float) -> Hand:
        hands.append(Hand(fleet, HandSettings(**{"silence_s": 60.0, **settings})))
        return hands[-1]

    yield make
    for one in hands:
        one.unplug()
        one.source.close()


def drive(pad: Hand, base: Any) -> None:
    """Press until the robot drives; again, if a busy machine delays the messages for too long."""
    for _ in range(20):
        with base.changed:
            twists, halts = base.twists, base.halts
        pad.send(LET_GO, FULL, HELD)
        wait_for(base, lambda: base.twists >= twists + 2 or base.halts > halts)  # noqa: B023
        with base.changed:
            if base.twist[0] > 0:
                return
    raise AssertionError("the robot never drove")


def halted(base: Any) -> None:
    wait_for(base, lambda: base.twist == [0.0, 0.0])


def test_release_unplugging_and_silence_halt(fleet: Fleet, hand: Callable[..., Hand]) -> None:
    bases = [resource_of(fleet, name, "Base") for name in ("one", "two")]
    pad = hand()
    for base in bases:
        drive(pad, base)
    pad.send(LET_GO)
    for base in bases:
        halted(base)
    drive(pad, bases[0])
    pad.unplug()
    for base in bases:
        halted(base)
    assert pad.error is not None
    assert "pipe have ended" in pad.error.message
    silent = hand(silence_s=0.5)
    drive(silent, bases[0])
    halted(bases[0])  # though it is still held
    drive(silent, bases[0])


def test_a_press_that_has_ended_before_it_is_read_drives_nothing(fleet: Fleet) -> None:
    """A program that was stopped for a while finds the events of that time at once; a part of them drove."""
    read, write = os.pipe()
    os.set_blocking(read, False)
    os.write(write, FULL + HELD + 1000 * FULL + LET_GO)
    os.close(write)
    with pytest.raises(EALError, match="have ended"):
        HandDriver(fleet, ["one"], HandSettings(), lambda _: None).run(InputSource("pipe", read, {}))
    os.close(read)
    fleet["one"]["Base"].send_cmd("turn90").get()  # behind every earlier call
    base = resource_of(fleet, "one", "Base")
    assert (base.twists, base.halts) == (0, 0)


def test_the_group_button_chooses_one_robot_after_another(fleet: Fleet, hand: Callable[..., Hand]) -> None:
    one, two = (resource_of(fleet, name, "Base") for name in ("one", "two"))
    pad = hand()
    pad.send(event(EV_KEY, START, 1), event(EV_KEY, START, 0))
    drive(pad, one)
    assert two.twists == 0
    pad.send(LET_GO, event(EV_KEY, START, 1), event(EV_KEY, START, 0))
    drive(pad, two)
    halted(one)
    assert [line for line in pad.lines if line.startswith("driving")] == ["driving one", "driving two"]


def test_a_gamepad_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(EALError, match="cannot be opened: No such file"):
        find_input(tmp_path / "event9")
    if not Path("/dev/input").exists():
        with pytest.raises(EALError, match="no gamepad: /dev/input has no devices"):
            find_input()
