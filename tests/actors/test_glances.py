"""A glance: a value that is known already, read past the mailbox."""

from __future__ import annotations

import threading
from typing import Any

from eal_actors.device.data import DataType
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.link import FaultyLink
from eal_actors.device.resource import Resource
from tests.robots import WAIT_S, running_robot


class Gauge(Resource):
    """Has a needle that is there to be read, and a slow way to ask."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "m")

    def __init__(self, needle: Any = 1.5) -> None:
        self.needle = needle
        self.is_asked, self.may_answer = threading.Event(), threading.Event()
        self.seen_in: list[int] = []

    def get_value(self) -> float:
        self.is_asked.set()
        assert self.may_answer.wait(WAIT_S)
        return 2.0

    def glance(self) -> Any:
        self.seen_in.append(threading.get_ident())
        if isinstance(self.needle, Exception):
            raise self.needle
        return self.needle


class Plain(Resource):
    """Must be asked."""

    types = ResourceType.SENSOR

    def get_value(self) -> int:
        return 3


def test_a_glance_waits_for_nothing_that_is_under_way() -> None:
    gauge = Gauge()
    with running_robot({"Gauge": lambda: gauge}) as robot:
        asked = robot["Gauge"].get_value()
        assert gauge.is_asked.wait(WAIT_S)
        seen = robot["Gauge"].glance()
        assert seen is not None
        assert (seen.value, asked.done()) == (1.5, False)
        assert gauge.seen_in == [threading.get_ident()]
        gauge.may_answer.set()
        assert asked.get().value == 2.0


def test_what_must_be_asked_for_is_not_seen() -> None:
    with running_robot({"Plain": Plain, "Gauge": lambda: Gauge(needle=None)}) as robot:
        assert robot["Plain"].glance() is None
        assert robot["Gauge"].glance() is None


def test_a_glance_that_fails_or_is_no_such_value_sees_nothing() -> None:
    broken, odd = Gauge(OSError("no such device")), Gauge("a text")
    with running_robot({"Broken": lambda: broken, "Odd": lambda: odd}) as robot:
        assert (robot["Broken"].glance(), robot["Odd"].glance()) == (None, None)
    assert broken.seen_in
    assert odd.seen_in


def test_nothing_is_seen_over_a_faulty_link_or_after_the_end() -> None:
    gauge, link = Gauge(), FaultyLink("robot")
    with running_robot({"Gauge": lambda: gauge}, link=link) as robot:
        link.impair(is_cut=True)
        assert robot["Gauge"].glance() is None
        link.impair(is_cut=False)
        assert robot["Gauge"].glance() is not None
        handle = robot["Gauge"]
    assert handle.glance() is None
