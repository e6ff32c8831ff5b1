from __future__ import annotations

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.log_limit import LogLimit


def test_lines_beyond_the_limit_are_counted_in_the_next_one() -> None:
    limit = LogLimit(most=2, period_s=0.2)
    assert [limit.admit() for _ in range(5)] == [{}, {}, None, None, None]
    REAL_TIME.sleep(0.25)
    assert limit.admit() == {"omitted": 3}
    assert limit.admit() == {}
