from __future__ import annotations

from structlog.testing import capture_logs

from eal_actors.kernel.throttled_log import PERIOD_S, ThrottledLog
from tests.manual_clock import ManualClock


def test_each_source_is_reported_once_in_a_period_and_the_rest_counted() -> None:
    clock = ManualClock(100.0)
    with capture_logs() as logs:
        log = ThrottledLog(clock, fleet="f")
        for _ in range(1000):
            log.warn("driver", "a call is malformed", "why")
        log.warn("display", "a call is malformed", "why")
        assert [(line["source"], line["reason"], line["fleet"]) for line in logs] == [
            ("driver", "why", "f"),
            ("display", "why", "f"),
        ]
        clock.advance(PERIOD_S)
        log.warn("driver", "a call is malformed", "why")
    assert logs[2]["by_source"] == {"driver": 999}
    assert logs[3]["source"] == "driver"
    assert len(logs) == 4


def test_names_that_a_stranger_invents_share_one_bound() -> None:
    clock = ManualClock()
    with capture_logs() as logs:
        log = ThrottledLog(clock)
        for number in range(10_000):
            log.warn(f"{number}" * 1000, "a call is malformed", "x" * 100_000)
        assert len(logs) == 10
        assert len(repr(logs)) < 10_000
        clock.advance(PERIOD_S)
        log.warn("driver", "a call is malformed", "why")
    assert logs[10]["other_sources"] == 9_990
