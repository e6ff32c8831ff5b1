"""The hub: the newest state wins, lines are counted where they are dropped, and readers cost nothing."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from eal_actors.operate.dashboard.hub import MOST_AT_ONCE, MOST_LINES, Hub, Reader, plain


def test_a_reader_gets_the_newest_state_of_each_cell_once() -> None:
    hub = Hub()
    reader = Reader(hub)
    for number in range(100):
        hub.put("poses", {"a": [number, 0, 0]})
    hub.put("poses", {"b": [1, 1, 1]})
    assert reader.take() == {"poses": {"a": [99, 0, 0], "b": [1, 1, 1]}}
    assert reader.take() == {}


def test_what_stays_as_it_was_is_no_news() -> None:
    rings = []
    hub = Hub(lambda: rings.append(1))
    hub.put("robots", {"a": {"state": "ready"}})
    reader = Reader(hub)
    reader.take()
    hub.put("robots", {"a": {"state": "ready"}})
    assert (reader.take(), len(rings)) == ({}, 1)


def test_what_is_no_number_is_no_news_twice_either() -> None:
    rings = []
    hub = Hub(lambda: rings.append(1))
    hub.put("robots", {"a": {"charge": math.nan}})
    hub.put("robots", {"a": {"charge": math.nan}})
    assert (hub.get("robots", "a"), len(rings)) == ({"charge": None}, 1)
    hub.put("robots", {"a": {"charge": 1.0}})
    hub.put("robots", {"a": {"charge": math.nan}})
    assert (hub.get("robots", "a"), len(rings)) == ({"charge": None}, 3)


def test_a_reader_that_comes_late_gets_everything_that_is_kept() -> None:
    hub = Hub()
    hub.put("robots", {"a": {"state": "ready"}})
    hub.tell("events", {"event": "run_started"})
    assert Reader(hub).take() == {"robots": {"a": {"state": "ready"}}, "events": [{"event": "run_started"}]}


def test_lines_beyond_what_is_kept_are_dropped_with_their_count() -> None:
    hub = Hub()
    slow = Reader(hub)
    most, extra = MOST_LINES["logs"], 7
    for number in range(most + extra):
        hub.tell("logs", {"number": number})
    numbers, lost = [], 0
    while news := slow.take():
        lost += news.get("logs_lost", 0)
        numbers += [line["number"] for line in news["logs"]]
        assert len(news["logs"]) <= MOST_AT_ONCE
    assert lost == extra
    assert numbers == list(range(extra, most + extra))


def test_a_cleared_topic_is_not_missed() -> None:
    hub = Hub()
    reader = Reader(hub)
    hub.tell("events", {"number": 1})
    reader.take()
    hub.clear("events")
    hub.tell("events", {"number": 2})
    assert reader.take() == {"events": [{"number": 2}]}


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 3), st.booleans())))
def test_whatever_is_read_when_the_last_state_arrives(steps: list[tuple[str, int, bool]]) -> None:
    hub = Hub()
    reader = Reader(hub)
    seen: dict[str, int] = {}
    state: dict[str, int] = {}
    for name, value, is_read in steps:
        hub.put("robots", {name: value})
        state[name] = value
        if is_read:
            seen.update(reader.take().get("robots", {}))
    seen.update(reader.take().get("robots", {}))
    assert seen == state


def test_what_goes_to_a_browser_is_json_that_every_browser_reads() -> None:
    class Odd:
        def __str__(self) -> str:
            return "odd"

    assert plain({"nan": math.nan, "inf": [math.inf], 3: (1, True, None), "odd": Odd()}) == {
        "nan": None,
        "inf": [None],
        "3": [1, True, None],
        "odd": "odd",
    }
