"""Calls of a robot itself wait in bounded numbers, and certificates take turns."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from eal_actors.kernel.errors import BusyError, ProtocolError
from eal_actors.wire.format.keys import CallKey, client_id
from eal_actors.wire.format.messages import CallHeader
from eal_actors.wire.rpc.server.request_handler import MOST_WAITING, RequestQueue


class Bench:
    """A queue whose host's thread is the test."""

    def __init__(self) -> None:
        self.mailbox: list[Callable[[], None]] = []
        self.queue = RequestQueue(self.mailbox.append)
        self.served: list[str] = []

    def add(self, who: str, robot: str = "r1", text: str = "") -> None:
        call = CallKey("f", robot, "_", "hello", who, "secret")
        header = CallHeader(client_id(who, "secret"), 1, 1, 1.0, 1.0, None, (text,))
        self.queue.add(call, header, partial(self.served.append, who))

    def run(self) -> None:
        while self.mailbox:
            self.mailbox.pop(0)()


def test_certificates_take_turns() -> None:
    bench = Bench()
    for who in ("mallory", "mallory", "mallory", "anna", "bert", "anna"):
        bench.add(who)
    bench.run()
    assert bench.served == ["mallory", "anna", "bert", "mallory", "anna", "mallory"]


def test_only_one_call_is_in_the_mailbox_so_that_timers_come_between() -> None:
    bench = Bench()
    for _ in range(3):
        bench.add("anna")
    assert len(bench.mailbox) == 1
    bench.mailbox.pop(0)()
    assert (bench.served, len(bench.mailbox)) == (["anna"], 1)


def test_one_certificate_cannot_fill_the_queue_for_others() -> None:
    bench = Bench()
    for _ in range(MOST_WAITING):
        bench.add("mallory")
    with pytest.raises(BusyError):
        bench.add("mallory")
    bench.add("anna")
    bench.add("mallory", robot="r2")
    bench.run()
    assert bench.served.count("mallory") == MOST_WAITING + 1
    bench.add("mallory")
    bench.run()
    assert bench.served[-1] == "mallory"


def test_long_texts_do_not_wait() -> None:
    bench = Bench()
    with pytest.raises(ProtocolError, match="texts"):
        bench.add("mallory", text="x" * 20_000)
    assert not bench.mailbox
