from __future__ import annotations

import json
from pathlib import Path

from eal_actors.facade.fleet import Fleet
from eal_actors.scenario import (
    StepRetried,
)
from tests.scenarios.rig import ask, rigs
from tests.scenarios.running import ON, THEN_NOW, Watch, brief, outcomes, records, run, run_rigs


def test_a_call_is_tried_again(tmp_path: Path) -> None:
    watch, folder = Watch(), tmp_path / "run"
    with rigs(tmp_path, a={"failures": 2}) as fleet:
        report = run(
            fleet,
            tmp_path,
            f"{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n    on_failure: {{retry: 2, back_off_s: 0.5}}\n",
            directory=folder,
            listeners=[watch],
        )

    (record,) = report.steps
    assert (report.outcome, record.outcome, record.attempts, record.error) == ("done", "done", 3, None)
    assert record.end_s - record.start_s >= 1.0
    retries = [event for event in watch.events if isinstance(event, StepRetried)]
    assert [(event.robot, event.step, event.label, event.attempt) for event in retries] == [
        ("a", "steps[0].do[0]", "send_cmd Base flaky", 1),
        ("a", "steps[0].do[0]", "send_cmd Base flaky", 2),
    ]
    assert [event.error.message.rpartition(": ")[2] for event in retries] == ["try 1", "try 2"]
    assert retries[1].time_s - retries[0].time_s >= 0.5
    written = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert [line for line in written if line["event"] == "step_retried"] == [event.to_dict() for event in retries]


def test_retries_come_to_an_end(tmp_path: Path) -> None:
    watch = Watch()
    body = f"on_failure: {{retry: 1}}\n{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n  - log: x\n"
    report = run_rigs(tmp_path, body, [watch], a={"failures": 2})

    (record,) = report.steps
    assert (report.outcome, record.outcome, record.attempts) == ("failed", "failed", 2)
    assert [event.attempt for event in watch.events if isinstance(event, StepRetried)] == [1], "the last one is final"
    assert record.error is not None
    assert (record.error.code, record.error.message) == (
        "resource_fault",
        "a/Base: send_cmd 'flaky' raised RuntimeError: try 2",
    )
    assert report.error == report.robots["a"].error == record.error


def test_a_robot_that_fails_is_dropped_and_the_others_go_on(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}, b={}) as fleet:
        report = run(fleet, tmp_path, f"on_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n{THEN_NOW}")
        halts = {robot: ask(fleet, robot, "halts") for robot in fleet}

    assert outcomes(report) == {"a": "dropped", "b": "done"}
    assert (report.outcome, report.dropped) == ("done", ["a"])
    assert brief(report, "a") == [("send_cmd Base flaky", "dropped", 1)]
    assert brief(report, "b") == [("send_cmd Base flaky", "done", 1), ("send_cmd Base now", "done", 1)]
    assert halts == {"a": 3, "b": 1}, "after the fault, at the drop, and at the end"


def test_without_any_robot_left_the_run_ends(tmp_path: Path) -> None:
    body = f"on_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n- wait_s: 1000\n"
    report = run_rigs(tmp_path, body, a={"failures": 1})

    assert (report.outcome, outcomes(report)) == ("failed", {"a": "dropped"})
    assert report.duration_s < 500


def test_a_failure_stops_the_others(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"slowness": 0.01}, b={}) as fleet:
        report = run(
            fleet,
            tmp_path,
            f"timeout_s: 500\n{ON}  - send_cmd: {{resource: Base, cmd: go100}}\n"
            "  - send_cmd: {resource: Base, cmd: fail}\n"
            "finally:\n- on: all\n  do: [{send_cmd: {resource: Base, cmd: s}}]\n",
        )
        halts = ask(fleet, "b", "halts")

    assert (report.outcome, outcomes(report)) == ("failed", {"a": "failed", "b": "aborted"})
    assert brief(report, "a") == [
        ("send_cmd Base go100", "done", 1),
        ("send_cmd Base fail", "failed", 1),
        ("send_cmd Base s", "done", 1),
    ]
    assert brief(report, "b") == [("send_cmd Base go100", "aborted", 1), ("send_cmd Base s", "done", 1)]
    assert report.duration_s < 90
    assert halts >= 2, "when the run was stopped, and at its end"


def test_a_step_overrides_the_policy(two: Fleet, tmp_path: Path) -> None:
    report = run(
        two, tmp_path, f"on_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: fail}}\n    on_failure: abort\n"
    )

    assert report.outcome == "failed"
    assert "dropped" not in outcomes(report).values()


def test_a_call_has_a_deadline(two: Fleet, tmp_path: Path) -> None:
    report = run(
        two,
        tmp_path,
        f"timeout_s: 500\non_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: go30}}\n    timeout_s: 10\n",
    )

    assert outcomes(report) == {"fast": "done", "slow": "dropped"}
    (record,) = records(report, "slow")
    assert record.error is not None
    assert record.error.code == "deadline"
    assert 10.0 <= record.end_s - record.start_s < 30.0


def test_a_resource_that_hangs_holds_nobody_up(tmp_path: Path) -> None:
    body = f"timeout_s: 5\non_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: hang}}\n{THEN_NOW}"
    report = run_rigs(tmp_path, body, a={"failures": 1}, b={})

    assert outcomes(report) == {"a": "dropped", "b": "done"}
    assert [record.error.code for record in records(report, "a") if record.error] == ["deadline"]
    assert brief(report, "b")[-1] == ("send_cmd Base now", "done", 1)


def test_a_variable_that_cannot_be_put_in_fails_the_step(two: Fleet, tmp_path: Path) -> None:
    report = run(
        two,
        tmp_path,
        f"{ON}  - get_value: {{resource: Eye}}\n    save_as: image\n"
        "  - send_cmd: {resource: Base, cmd: say, data: 'a ${image}'}\n    on_failure: drop\n",
    )

    record = records(report, "slow")[-1]
    assert (record.outcome, record.attempts) == ("dropped", 0)
    assert record.error is not None
    assert "${image} is of type list, which has no form in a text" in record.error.message


def test_what_cannot_be_saved_fails_the_step(two: Fleet, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "fast").write_text("in the way")
    report = run(
        two,
        tmp_path,
        f"on_failure: drop\n{ON}  - get_value: {{resource: Eye}}\n    save: a.png\n",
        directory=folder,
    )

    assert outcomes(report) == {"fast": "dropped", "slow": "done"}
    assert "could not save 'a.png'" in str(records(report, "fast")[0].error)


def test_a_log_that_cannot_be_made_is_no_hang(two: Fleet, tmp_path: Path) -> None:
    report = run(two, tmp_path, f"{ON}  - get_value: {{resource: Eye}}\n    save_as: image\n  - log: '${{image}}'\n")

    assert report.outcome == "failed"
    assert report.error is not None
    assert "has no form in a text" in report.error.message
