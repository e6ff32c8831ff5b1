"""A short soak in every test run; `make soak` is the long one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.soak.report import Report
from tests.soak.run import KINDS, Plan, Soak


@pytest.mark.timeout(400)
def test_a_fleet_comes_through_kills_freezes_cuts_floods_and_garbage(tmp_path: Path) -> None:
    report = Report.of(Soak(Plan(robots=6, duration_s=45.0, seed=5), tmp_path).run())
    told = "\n".join(report.lines())
    assert report.holds, told
    kinds = {what for what in report.counts if what.startswith("fault: ")}
    assert kinds == {f"fault: {kind}" for kind in KINDS}, told
    assert report.counts["command: ok"] > 100, told
    assert report.counts["robot seen as lost"] > 5, told
    assert report.counts["dead-man's switch"] > 0, told
