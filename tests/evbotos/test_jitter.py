"""The loop whose lateness `make bench-jitter` measures."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.benchmarks.jitter import PROGRAM, STATES, table_of


def test_the_loop_measures_each_state_with_each_priority() -> None:
    argv = [sys.executable, str(PROGRAM), "0.2"]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=120, check=False)
    found = [json.loads(line) for line in done.stdout.splitlines()]
    expected = [(priority, state) for priority in ("ordinary", "real-time") for state in STATES]
    assert [(one["priority"], one["state"]) for one in found] == expected[: len(found)]
    assert len(found) == 6 or (len(found) == 3 and "real-time priority is not permitted" in done.stderr)
    for one in found:
        assert one["loops"] == 10
        assert 0 < one["99 %"] <= one["worst"]


def test_the_table_has_a_row_for_each_kernel_and_priority() -> None:
    figures = {"99 %": 14.2, "worst": 3688.3}
    results = [
        {"priority": priority, "state": state, "loops": 10, **figures}
        for priority in ("ordinary", "real-time")
        for state in STATES
    ]
    lines = table_of({"ours": results}).splitlines()
    assert lines[0].count("|") == lines[-1].count("|")
    assert lines[-1] == "| ours | real-time | 14 | 3688 | 14 | 3688 | 14 | 3688 |"
