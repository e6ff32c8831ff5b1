"""`retry` on a block repeats the whole block."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.kernel.lock_step import LockStepClock
from tests.scenarios.rig import HEAD, ask, rigs
from tests.scenarios.running import ON, brief, outcomes, records, run

FLAKY = "{send_cmd: {resource: Base, cmd: flaky}}"
NOW = "{send_cmd: {resource: Base, cmd: now}}"
RETRY = "on_failure: {retry: 2, back_off_s: 0.1}"


@pytest.mark.parametrize(
    "block",
    [
        f"sequence: [{NOW}, {FLAKY}, {{log: end}}]",
        f"repeat: 1\n    do: [{NOW}, {FLAKY}, {{log: end}}]",
        f"for: {{x: [1]}}\n    do: [{NOW}, {{sequence: [{FLAKY}]}}, {{log: end}}]",
        f"if: 'true'\n    then: [{NOW}, {{if: 'true', then: [{FLAKY}]}}, {{log: end}}]",
    ],
)
def test_the_steps_before_the_failed_one_run_again(tmp_path: Path, block: str) -> None:
    with rigs(tmp_path, a={"failures": 4}) as fleet:  # `now` counts as a try too
        report = run(fleet, tmp_path, f"{ON}  - {block}\n    {RETRY}\n")
        assert report.outcome == "done", report.error
        assert [(label, outcome) for label, outcome, _ in brief(report, "a") if "log" not in label] == [
            ("send_cmd Base now", "done"),
            ("send_cmd Base flaky", "failed"),
            ("send_cmd Base now", "done"),
            ("send_cmd Base flaky", "failed"),
            ("send_cmd Base now", "done"),
            ("send_cmd Base flaky", "done"),
        ]
        assert ask(fleet, "a", "halts") >= 2


def test_the_last_failure_follows_then(tmp_path: Path) -> None:
    for then, outcome in (("abort", "failed"), ("skip", "done"), ("drop", "done")):
        (folder := tmp_path / then).mkdir()
        with rigs(folder, a={"failures": 9}, b={}) as fleet:
            retry = f"on_failure: {{retry: 1, then: {then}}}"
            report = run(fleet, folder, f"{ON}  - sequence: [{FLAKY}]\n    {retry}\n  - {NOW}\n")
        assert report.outcome == outcome
        assert outcomes(report)["a"] == {"abort": "failed", "skip": "done", "drop": "dropped"}[then]
        (block,) = [record for record in records(report, "a") if record.kind == "sequence"]
        assert block.attempts == 2
        assert "try 2" in str(block.error)


def test_an_on_repeats_for_the_robot_that_failed_alone(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 3}, b={}) as fleet:
        body = f"steps:\n- on: all\n  {RETRY}\n  do: [{NOW}, {FLAKY}]\n"
        report = run(fleet, tmp_path, body)
        assert (report.outcome, outcomes(report)) == ("done", {"a": "done", "b": "done"})
        assert [ask(fleet, robot, "tries") for robot in fleet] == [4, 2]


def test_a_block_around_several_robots_stops_and_repeats_all(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}, b={}) as fleet:
        go = """{send_cmd: {resource: Base, cmd: "go${99 if request('Base', 'halts') == 0 else 0}"}}"""
        body = f"""
        steps:
        - sequence:
          - on: all
            do:
            - if: index == 0
              then: [{{wait_s: 0.5}}, {FLAKY}]
              else: [{go}]
          - log: through
          {RETRY}
        """
        report = run(fleet, tmp_path, body)
        assert (report.outcome, outcomes(report)) == ("done", {"a": "done", "b": "done"})
        assert [record.outcome for record in records(report, "b")] == ["stopped", "done"]


def test_a_policy_inside_the_block_comes_first(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}) as fleet:
        step = f"{FLAKY[:-1]}, on_failure: {{retry: 1}}}}"
        report = run(fleet, tmp_path, f"{ON}  - sequence: [{step}, {NOW}]\n    {RETRY}\n")
        assert brief(report, "a") == [("send_cmd Base flaky", "done", 2), ("send_cmd Base now", "done", 1)]
    with rigs(tmp_path, a={"failures": 1}) as fleet:
        report = run(fleet, tmp_path, f"{ON}  - sequence: [{FLAKY[:-1]}, on_failure: abort}}]\n    {RETRY}\n")
        assert report.outcome == "failed"


def test_an_abort_ends_the_attempts(tmp_path: Path) -> None:
    part = HEAD + f"steps: [{{on: all, do: [{FLAKY}]}}]\n"
    (tmp_path / "part.yaml").write_text(part)
    with rigs(tmp_path, a={"failures": 1}) as fleet:  # the steps of a part have the policies of its own file
        report = run(fleet, tmp_path, f"steps:\n- sequence: [{{scenario: part.yaml}}]\n  {RETRY}\n")
        assert report.outcome == "failed"
        assert [record.attempts for record in records(report, "a")] == [1]


def test_a_repeated_block_begins_its_common_command_alone_for_the_others_have_gone_on(tmp_path: Path) -> None:
    together = "{send_cmd: {resource: Base, cmd: now}, together: true}"
    with rigs(tmp_path, clock=LockStepClock(), a={"failures": 2}, b={}) as fleet:  # `now` counts as a try too
        body = (
            f"{ON}  - sequence:\n    - repeat: 1\n      do: [{together}]\n    - {FLAKY}\n    {RETRY}\n  - {together}\n"
        )
        report = run(fleet, tmp_path, body)

    assert report.outcome == "done", report.error
    assert [set(start.begins) for start in report.starts] == [{"a", "b"}, {"a", "b"}]
    assert len(records(report, "a")) == len(records(report, "b")) + 2


def test_a_block_that_repeats_before_its_common_command_meets_the_others(tmp_path: Path) -> None:
    together = "{send_cmd: {resource: Base, cmd: now}, together: true}"
    with rigs(tmp_path, clock=LockStepClock(), a={"failures": 1}, b={}) as fleet:
        report = run(fleet, tmp_path, f"{ON}  - sequence: [{FLAKY}, {together}]\n    {RETRY}\n")

    assert [set(start.begins) for start in report.starts] == [{"a", "b"}]
