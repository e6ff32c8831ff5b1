"""StateStore: the newest state wins, dropped lines are counted, and readers cost nothing."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from eal_actors.operate.dashboard.state_store import MOST_AT_ONCE, MOST_LINES, StateReader, StateStore, to_json_value


def test_a_reader_gets_the_newest_state_of_each_cell_once() -> None:
    store = StateStore()
    reader = StateReader(store)
    for number in range(100):
        store.put("poses", {"a": [number, 0, 0]})
    store.put("poses", {"b": [1, 1, 1]})
    assert reader.take() == {"poses": {"a": [99, 0, 0], "b": [1, 1, 1]}}
    assert reader.take() == {}


def test_an_unchanged_value_is_no_change() -> None:
    changes = []
    store = StateStore()
    store.on_change = lambda: changes.append(1)
    store.put("robots", {"a": {"state": "ready"}})
    reader = StateReader(store)
    reader.take()
    store.put("robots", {"a": {"state": "ready"}})
    assert (reader.take(), len(changes)) == ({}, 1)


def test_an_unchanged_nan_is_no_change() -> None:
    changes = []
    store = StateStore()
    store.on_change = lambda: changes.append(1)
    store.put("robots", {"a": {"charge": math.nan}})
    store.put("robots", {"a": {"charge": math.nan}})
    assert (store.get("robots", "a"), len(changes)) == ({"charge": None}, 1)
    store.put("robots", {"a": {"charge": 1.0}})
    store.put("robots", {"a": {"charge": math.nan}})
    assert (store.get("robots", "a"), len(changes)) == ({"charge": None}, 3)


def test_a_late_reader_gets_everything_that_is_kept() -> None:
    store = StateStore()
    store.put("robots", {"a": {"state": "ready"}})
    store.append("events", {"event": "run_started"})
    assert StateReader(store).take() == {"robots": {"a": {"state": "ready"}}, "events": [{"event": "run_started"}]}


def test_dropped_lines_are_counted() -> None:
    store = StateStore()
    slow = StateReader(store)
    most, extra = MOST_LINES["logs"], 7
    for number in range(most + extra):
        store.append("logs", {"number": number})
    numbers, lost = [], 0
    while update := slow.take():
        lost += update.get("logs_lost", 0)
        numbers += [line["number"] for line in update["logs"]]
        assert len(update["logs"]) <= MOST_AT_ONCE
    assert lost == extra
    assert numbers == list(range(extra, most + extra))


def test_cleared_lines_are_not_counted_as_lost() -> None:
    store = StateStore()
    reader = StateReader(store)
    store.append("events", {"number": 1})
    reader.take()
    store.clear("events")
    store.append("events", {"number": 2})
    assert reader.take() == {"events": [{"number": 2}]}


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 3), st.booleans())))
def test_the_last_state_arrives_whenever_it_is_read(steps: list[tuple[str, int, bool]]) -> None:
    store = StateStore()
    reader = StateReader(store)
    seen: dict[str, int] = {}
    state: dict[str, int] = {}
    for name, value, is_read in steps:
        store.put("robots", {name: value})
        state[name] = value
        if is_read:
            seen.update(reader.take().get("robots", {}))
    seen.update(reader.take().get("robots", {}))
    assert seen == state


def test_values_are_converted_to_strict_json() -> None:
    class Odd:
        def __str__(self) -> str:
            return "odd"

    assert to_json_value({"nan": math.nan, "inf": [math.inf], 3: (1, True, None), "odd": Odd()}) == {
        "nan": None,
        "inf": [None],
        "3": [1, True, None],
        "odd": "odd",
    }
