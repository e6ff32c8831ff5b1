"""Faults of the link on purpose: calls that come late, get lost, or never arrive."""

from __future__ import annotations

import pytest

from eal_actors.device.link import FaultyLink
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.errors import DeadlineError, EALError
from eal_actors.kernel.lock_step import LockStepClock
from tests.robots import running_robot


class Wheel(Resource):
    """Turns until it is stopped; tells when it was asked."""

    def __init__(self, clock: LockStepClock) -> None:
        self.clock = clock
        self.halted_s: list[float] = []

    def get_status(self) -> int:
        return round(self.clock.now() * 1000)

    def halt(self) -> None:
        self.halted_s.append(self.clock.now())

    @command("turn")
    def turn(self) -> Activity:
        """Turn for a minute."""
        yield 60.0
        return 1


def test_a_delay_is_on_the_fleets_clock_and_keeps_the_order() -> None:
    clock, link = LockStepClock(), FaultyLink("robot")
    with running_robot({"Wheel": lambda: Wheel(clock)}, clock=clock, link=link) as robot:
        began_ms = robot["Wheel"].get_status().get()
        link.impair(delay_s=0.25)
        first, second = robot["Wheel"].get_status(), robot["Wheel"].get_status()
        assert second.get() == began_ms + 250
        assert first.get() == began_ms + 250


def test_a_cut_link_leaves_callers_waiting_until_their_deadline() -> None:
    clock, link = LockStepClock(), FaultyLink("robot")
    with running_robot({"Wheel": lambda: Wheel(clock)}, clock=clock, link=link) as robot:
        link.impair(is_cut=True)
        asked_s = clock.now()
        with pytest.raises(DeadlineError):
            robot["Wheel"].get_status(timeout_s=3.0).get()
        assert clock.now() == pytest.approx(asked_s + 3.0)
        assert link.lost >= 1
        link.impair(is_cut=False)
        assert robot["Wheel"].get_status().get() > 0


def test_a_motion_ends_at_its_deadline_though_its_link_was_cut() -> None:
    clock, link = LockStepClock(), FaultyLink("robot")
    wheel = Wheel(clock)
    with running_robot({"Wheel": lambda: wheel}, clock=clock, link=link) as robot:
        turning = robot["Wheel"].send_cmd("turn", timeout_s=5.0)
        clock.sleep(1.0)
        link.impair(is_cut=True)
        asked_s = turning.deadline_s
        with pytest.raises(DeadlineError):
            turning.get()
        clock.sleep(60.0)
        assert asked_s is not None
        assert wheel.halted_s[0] >= asked_s


def test_spared_resources_are_always_reached() -> None:
    clock, link = LockStepClock(), FaultyLink("robot")
    link.spare(["Wheel"])
    link.impair(is_cut=True)
    with running_robot({"Wheel": lambda: Wheel(clock)}, clock=clock, link=link) as robot:
        assert robot["Wheel"].get_status().get() >= 0
        assert link.lost == 0


def which_arrive(seed: int, name: str = "robot") -> list[bool]:
    clock, link = LockStepClock(), FaultyLink(name, seed)
    link.impair(loss=0.3)
    arrived = []
    with running_robot({"Wheel": lambda: Wheel(clock)}, clock=clock, link=link) as robot:
        for _ in range(200):
            try:
                robot["Wheel"].get_status(timeout_s=0.5).get()
            except EALError:
                arrived.append(False)
            else:
                arrived.append(True)
        link.impair(loss=0.0)
    return arrived


def test_losses_have_their_rate_and_repeat() -> None:
    arrived = which_arrive(seed=1)
    assert 40 <= arrived.count(False) <= 80  # 60 expected, standard deviation 6.5
    assert arrived == which_arrive(seed=1)
    assert arrived != which_arrive(seed=2)
    assert arrived != which_arrive(seed=1, name="other")
