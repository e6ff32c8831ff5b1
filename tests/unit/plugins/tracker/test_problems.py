"""The list of a tracker's problems."""

from __future__ import annotations

from plugins.tracker.problems import ProblemList, TrackingProblem


def test_a_problem_that_comes_and_goes_is_told_once_a_minute() -> None:
    told: list[float] = []
    problems = ProblemList(lambda one: told.append(one.since_s))
    for second in range(150):
        hidden = TrackingProblem("not_seen", "", 12, "marker 12 is hidden or out of view", float(second))
        problems.replace(["not_seen"], "", [hidden] if second % 2 else [])
        assert len(problems.present) == second % 2
    assert told == [1.0, 61.0, 121.0]
    other = TrackingProblem("not_seen", "", 13, "marker 13 is hidden or out of view", 150.0)
    problems.replace(["not_seen"], "", [other])
    assert told[-1] == 150.0
