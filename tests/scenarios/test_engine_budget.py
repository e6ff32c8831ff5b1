"""The expressions of a run are bounded in work and in the size of what they keep, and never keep a stop waiting."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.scenario import LogLine, Run, RunEvent, make_plan
from eal_actors.scenario.engine import context
from tests.scenario_texts import BOMB
from tests.scenarios.rig import HEAD, scenario
from tests.scenarios.running import WAIT_S, run


def message(report: object) -> str:
    error = getattr(report, "error", None)
    assert error is not None
    return str(error.message)


def test_a_value_that_grows_out_of_others_is_refused_by_its_place(two: Fleet, tmp_path: Path) -> None:
    report = run(two, tmp_path, BOMB)
    assert report.outcome == "failed"
    assert message(report).startswith("the list has more than 100000 items")
    assert report.steps[-1].step == "steps[3]"


def test_the_variables_of_all_robots_are_bounded_together(
    two: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(context, "_MAX_KEPT", 1000)
    lets = "".join(f"  - let: {{x{number}: 'range(90 + index)'}}\n" for number in range(6))
    report = run(two, tmp_path, f"steps:\n- on: all\n  do:\n{lets}")
    assert message(report).endswith("the variables of this run hold more than 1000 items and characters")
    again = "steps:\n- on: all\n  do:\n  - repeat: 50\n    do: [{let: {x: 'range(90 + i)', y: 'x'}}]\n"
    assert run(two, tmp_path, again).outcome == "done"


def test_a_part_gives_its_variables_back(two: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(context, "_MAX_KEPT", 1000)
    part = "parameters: {a: {type: list}}\nsteps:\n- on: all\n  do: [{let: {x: 'range(90)'}}]\n"
    (tmp_path / "part.yaml").write_text(HEAD + part)
    body = "steps:\n- on: all\n  do:\n  - repeat: 20\n    do: [{scenario: part.yaml, with: {a: '${range(90)}'}}]\n"
    assert run(two, tmp_path, body).outcome == "done"


def test_the_work_of_a_run_is_bounded(two: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(context, "_MAX_WORK", 20_000)
    monkeypatch.setattr(context, "_MAX_WORK_EACH_S", 0)
    report = run(two, tmp_path, "steps:\n- repeat: 1000\n  do:\n  - let: {x: 'range(90 + i)'}\n")
    assert message(report) == (
        "up to here, the expressions of this run need more work than 20000 items, characters and operations"
    )
    assert report.steps[-1].step == "steps[0].do[0]"


def test_a_stop_comes_in_between_steps_that_only_compute(two: Fleet, tmp_path: Path) -> None:
    body = "steps:\n- let: {n: 9000}\n- log: go\n" + "- let: {x: 'range(n)[0]'}\n" * 200 + "- log: through\n"
    lines: list[str] = []

    def stop(event: RunEvent) -> None:
        if isinstance(event, LogLine):
            lines.append(event.text)
            running.abort("enough")

    running = Run(make_plan(scenario(tmp_path, body), two), two, listeners=[stop])
    assert running.start().get(timeout=two.clock.of_real(WAIT_S)).outcome == "aborted"
    assert lines == ["go"]
