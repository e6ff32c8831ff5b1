from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from eal_actors.actors.future import Future
from eal_actors.clock import ManualClock
from eal_actors.errors import ConfigError, RobotFailedError, RobotNotFoundError, ScenarioError
from eal_actors.facade.fleet import Fleet
from eal_actors.scenario import (
    Event,
    LogLine,
    Report,
    RobotDropped,
    Run,
    RunEnded,
    RunStarted,
    StepEnded,
    StepRecord,
    StepRetried,
    StepStarted,
    make_plan,
    run_scenario,
    summary_schema,
)
from tests.robots import advance_until_done
from tests.scenarios.rig import HEAD, ask, rigs, scenario

WAIT_S = 20.0
"""Real seconds after which a test that waits for something gives up."""


@pytest.fixture
def two(tmp_path: Path) -> Iterator[Fleet]:
    with rigs(tmp_path, fast={"slowness": 0.1, "tags": ["quick"]}, slow={"tags": ["heavy"]}) as fleet:
        yield fleet


def run(fleet: Fleet, folder: Path, body: str, head: str = HEAD, **keywords: Any) -> Report:
    return run_scenario(scenario(folder, body, head), fleet, **keywords)


def records(report: Report, robot: str) -> list[StepRecord]:
    return [record for record in report.steps if record.robot == robot]


def brief(report: Report, robot: str) -> list[tuple[str, str, int]]:
    return [(record.label, record.outcome, record.attempts) for record in records(report, robot)]


def outcomes(report: Report) -> dict[str, str]:
    return {name: robot.outcome for name, robot in report.robots.items()}


class Watch:
    """A listener that keeps the events, and acts once when a step with a certain label begins."""

    def __init__(self, label: str = "", action: Callable[[], object] = lambda: None) -> None:
        self.events: list[Event] = []
        self._label = label
        self._action = action

    def __call__(self, event: Event) -> None:
        self.events.append(event)
        if isinstance(event, StepStarted) and event.label == self._label:
            self._label = ""
            self._action()


ON = "steps:\n- on: all\n  do:\n"


# When all goes well.


def test_robots_move_at_once_and_wait_for_each_other(two: Fleet, tmp_path: Path) -> None:
    report = run(
        two,
        tmp_path,
        f"{ON}  - send_cmd: {{resource: Base, cmd: go9}}\n"
        "- on: all\n  do:\n  - send_cmd: {resource: Base, cmd: now}\n",
    )
    fast, slow = records(report, "fast"), records(report, "slow")

    assert (report.outcome, report.error) == ("done", None)
    assert outcomes(report) == {"fast": "done", "slow": "done"}
    assert slow[0].start_s < fast[0].end_s < slow[0].end_s
    assert slow[0].end_s - slow[0].start_s >= 9.0
    assert fast[1].start_s >= slow[0].end_s, "the barrier"


def test_within_an_on_nobody_waits(two: Fleet, tmp_path: Path) -> None:
    report = run(
        two, tmp_path, f"{ON}  - send_cmd: {{resource: Base, cmd: go4}}\n  - send_cmd: {{resource: Base, cmd: now}}\n"
    )

    assert records(report, "fast")[1].end_s < records(report, "slow")[0].end_s


def test_roles_loops_variables_and_logs(two: Fleet, tmp_path: Path) -> None:
    head = HEAD.replace("all: {}", "all: {}\n  quick: {tags: [quick]}")
    watch = Watch()
    report = run(
        two,
        tmp_path,
        """
        steps:
          - for: {number: [3, 4]}
            do:
              - log: "now ${number}"
              - on: quick
                do:
                  - set_value: {resource: Base, value: "${number}"}
                  - get_value: {resource: Base}
                    save_as: seen
                  - repeat: 2
                    do:
                      - log: "${i}: ${seen}"
                      - send_cmd: {resource: Base, cmd: say, data: "${i} of ${number}"}
          - on: quick
            do:
              - send_req: {resource: Base, req: said}
                save_as: said
              - log: "said ${said}"
        """,
        head,
        listeners=[watch],
    )

    logs = [(event.robot, event.text) for event in watch.events if isinstance(event, LogLine)]
    assert logs == [
        (None, "now 3"),
        ("fast", "0: 3"),
        ("fast", "1: 3"),
        (None, "now 4"),
        ("fast", "0: 4"),
        ("fast", "1: 4"),
        ("fast", "said 1 of 4"),
    ]
    assert [record.step for record in report.steps][:3] == [
        "steps[0].do[1].do[0]",
        "steps[0].do[1].do[1]",
        "steps[0].do[1].do[2].do[1]",
    ]
    assert records(report, "slow") == []
    assert outcomes(report) == {"fast": "done", "slow": "done"}


def test_every_call_of_the_api_can_be_made(two: Fleet, tmp_path: Path) -> None:
    report = run(
        two,
        tmp_path,
        """
        steps:
          - on: all
            do:
              - set_config: {resource: Base, key: gain, value: 0.5}
              - get_config: {resource: Base, key: gain}
                save_as: gain
              - log: "${gain}"
              - set_value: {resource: Base, value: 5}
              - get_value: {resource: Base}
              - send_req: {resource: Eye, req: name}
              - send_cmd: {resource: Base, cmd: say, data: hello}
              - halt: {resource: Base}
        """,
    )

    assert report.outcome == "done"
    first = records(report, "fast")
    assert [(record.method, record.command, record.label) for record in first] == [
        ("set_config", "gain", "set_config Base gain 0.5"),
        ("get_config", "gain", "get_config Base gain"),
        ("set_value", None, "set_value Base 5"),
        ("get_value", None, "get_value Base"),
        ("send_req", "name", "send_req Eye name"),
        ("send_cmd", "say", "send_cmd Base say hello"),
        ("halt", None, "halt Base"),
    ]


def test_answers_are_saved_in_a_folder_for_each_robot(two: Fleet, tmp_path: Path) -> None:
    from matplotlib.image import imread

    folder = tmp_path / "run"
    body = """
        steps:
          - on: all
            do:
              - repeat: 2
                do:
                  - get_value: {resource: Eye}
                    save: "frame.${i}.png"
              - send_req: {resource: Eye, req: frame}
                save: frame.json
        """
    assert run(two, tmp_path, body, directory=folder).outcome == "done"

    for robot in ("fast", "slow"):
        names = sorted(path.name for path in (folder / robot).iterdir())
        assert names == ["frame.0.png", "frame.1.png", "frame.json"]
        assert np.rint(imread(folder / robot / "frame.1.png")[0, 0, 0] * 255) == 200
        assert (folder / robot / "frame.json").read_text() == "[1, 0]"
    with pytest.raises(ScenarioError, match="'trial' saves files, so its run needs a directory"):
        run(two, tmp_path, body)


def test_time_is_the_fleets(tmp_path: Path) -> None:
    clock = ManualClock()
    with rigs(tmp_path, clock=clock, a={}) as fleet:
        plan = make_plan(scenario(tmp_path, f"{ON}  - wait_s: 3\nfinally: [{{wait_s: 2}}]\n"), fleet)
        future = Run(plan, fleet).start()
        advance_until_done(clock, future)

    assert future.get().duration_s >= 5.0


# What is written down.


def test_the_files_hold_what_the_report_does(two: Fleet, tmp_path: Path) -> None:
    watch, folder = Watch(), tmp_path / "runs" / "first"
    report = run(
        two,
        tmp_path,
        f"on_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: fail}}\n  - wait_s: 1\n",
        directory=folder,
        listeners=[watch],
    )

    summary = json.loads((folder / "summary.json").read_text())
    lines = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    jsonschema.validate(summary, summary_schema(), jsonschema.Draft202012Validator)
    assert summary == report.model_dump(mode="json")
    assert lines == [event.to_dict() for event in watch.events]
    assert [line["record"] for line in lines if line["event"] == "step_ended"] == summary["steps"]
    assert sorted(path.name for path in folder.iterdir()) == ["events.jsonl", "summary.json"]
    assert (report.fleet, report.rate, report.seed) == ("rigs", 20.0, 0)
    assert report.fleet_file == str(tmp_path / "fleet.yaml")
    assert report.started.endswith("+00:00")


def test_events_come_in_order(tmp_path: Path) -> None:
    watch = Watch()
    with rigs(tmp_path, a={}) as fleet:
        report = run(
            fleet,
            tmp_path,
            f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n  - send_cmd: {{resource: Base, cmd: fail}}\n"
            "    on_failure: drop\n",
            listeners=[watch],
        )

    kinds = [type(event) for event in watch.events]
    assert kinds == [RunStarted, StepStarted, StepEnded, StepStarted, StepEnded, RobotDropped, RunEnded]
    started, ended = watch.events[0], watch.events[-1]
    assert isinstance(started, RunStarted)
    assert (started.scenario, started.fleet, started.robots, started.calls) == ("trial", "rigs", ("a",), 2)
    assert isinstance(ended, RunEnded)
    assert ended.report == report
    assert [event.time_s for event in watch.events] == sorted(event.time_s for event in watch.events)


def test_a_listener_that_raises_is_told_no_more(two: Fleet, tmp_path: Path) -> None:
    calls: list[Event] = []

    def clumsy(event: Event) -> None:
        calls.append(event)
        raise SystemExit

    watch = Watch()
    report = run(two, tmp_path, f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n", listeners=[clumsy, watch])

    assert (report.outcome, len(calls)) == ("done", 1)
    assert len(watch.events) == 6


def test_a_run_overwrites_no_other(two: Fleet, tmp_path: Path) -> None:
    run(two, tmp_path, "steps: [{log: x}]", directory=tmp_path / "run")

    with pytest.raises(ScenarioError, match="holds the record of a run already"):
        run(two, tmp_path, "steps: [{log: x}]", directory=tmp_path / "run")


def test_a_run_is_for_once(two: Fleet, tmp_path: Path) -> None:
    once = Run(make_plan(scenario(tmp_path, "steps: [{log: x}]"), two), two)
    once.start().get()

    with pytest.raises(ScenarioError, match="a run is for once"):
        once.start()


def test_a_run_tells_when_it_began(tmp_path: Path) -> None:
    clock = ManualClock(100.0)
    with rigs(tmp_path, clock=clock, a={}) as fleet:
        once = Run(make_plan(scenario(tmp_path, "steps: [{wait_s: 3}]\n"), fleet), fleet)
        with pytest.raises(ScenarioError, match="this run was not started"):
            _ = once.start_s
        future = once.start()
        assert once.start_s == 100.0
        advance_until_done(clock, future)

        assert once.start_s == 100.0


# Failures.


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
    with rigs(tmp_path, a={"failures": 2}) as fleet:
        report = run(
            fleet,
            tmp_path,
            f"on_failure: {{retry: 1}}\n{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n  - log: x\n",
            listeners=[watch],
        )

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
        report = run(
            fleet,
            tmp_path,
            f"on_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n"
            "- on: all\n  do:\n  - send_cmd: {resource: Base, cmd: now}\n",
        )
        halts = {robot: ask(fleet, robot, "halts") for robot in fleet}

    assert outcomes(report) == {"a": "dropped", "b": "done"}
    assert report.outcome == "failed"
    assert brief(report, "a") == [("send_cmd Base flaky", "dropped", 1)]
    assert brief(report, "b") == [("send_cmd Base flaky", "done", 1), ("send_cmd Base now", "done", 1)]
    assert halts == {"a": 3, "b": 1}, "after the fault, at the drop, and at the end"


def test_without_any_robot_left_the_run_ends(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}) as fleet:
        report = run(
            fleet, tmp_path, f"on_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n- wait_s: 1000\n"
        )

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
    with rigs(tmp_path, a={"failures": 1}, b={}) as fleet:
        report = run(
            fleet,
            tmp_path,
            f"timeout_s: 5\non_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: hang}}\n"
            "- on: all\n  do:\n  - send_cmd: {resource: Base, cmd: now}\n",
        )

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
    assert "'image' is of type ndarray, which cannot stand in a text" in record.error.message


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
    assert "cannot stand in a text" in report.error.message


# The end.

FINALLY = """\
finally:
  - on: all
    do:
      - send_cmd: {resource: Base, cmd: fail}
      - send_cmd: {resource: Base, cmd: s}
"""


def test_a_failure_in_finally_stops_nothing(two: Fleet, tmp_path: Path) -> None:
    report = run(two, tmp_path, f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n{FINALLY}")

    assert (report.outcome, outcomes(report)) == ("failed", {"fast": "failed", "slow": "failed"})
    for robot in ("fast", "slow"):
        assert brief(report, robot) == [
            ("send_cmd Base now", "done", 1),
            ("send_cmd Base fail", "failed", 1),
            ("send_cmd Base s", "done", 1),
        ]
        assert ask(two, robot, "stops") == 1


def test_dropped_robots_take_part_in_finally(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}, b={}) as fleet:
        report = run(fleet, tmp_path, f"on_failure: drop\n{ON}  - send_cmd: {{resource: Base, cmd: flaky}}\n{FINALLY}")

        assert outcomes(report) == {"a": "dropped", "b": "failed"}
        assert [ask(fleet, robot, "stops") for robot in fleet] == [1, 1]


def test_a_robot_that_cannot_be_halted_has_failed(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"refuses_halt": True}, b={}) as fleet:
        report = run(fleet, tmp_path, f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n")

    assert (report.outcome, outcomes(report)) == ("failed", {"a": "failed", "b": "done"})
    assert "no brakes" in str(report.error)


def abort_at(
    fleet: Fleet, folder: Path, label: str, body: str, abort: Callable[[Run], object], times: int = 1
) -> Report:
    """Run a scenario, and abort it from this thread when a step with the label begins."""
    reached = threading.Event()
    aborted = Run(make_plan(scenario(folder, body), fleet), fleet, None, [Watch(label, reached.set)])
    future: Future[Report] = aborted.start()
    assert reached.wait(WAIT_S)
    for _ in range(times):
        abort(aborted)
    return future.get()


LONG = f"timeout_s: 500\n{ON}  - send_cmd: {{resource: Base, cmd: go100}}\n"


def test_an_abort_stops_the_robots_and_runs_finally(two: Fleet, tmp_path: Path) -> None:
    report = abort_at(two, tmp_path, "send_cmd Base go100", LONG + FINALLY, lambda run: run.abort("enough"))

    assert report.outcome == "aborted"
    assert report.error is not None
    assert (report.error.code, report.error.message) == ("scenario", "aborted: enough")
    assert outcomes(report) == {"fast": "aborted", "slow": "aborted"}
    record = records(report, "slow")[0]
    assert (record.label, record.outcome, record.error and record.error.code) == (
        "send_cmd Base go100",
        "aborted",
        "cancelled",
    )
    assert [ask(two, robot, "stops") for robot in two] == [1, 1]
    assert report.duration_s < 90


def test_an_abort_ends_waits_and_back_offs(two: Fleet, tmp_path: Path) -> None:
    body = (
        "on_failure: {retry: 1, back_off_s: 1000}\nsteps:\n- on: all\n  do:\n"
        "  - send_cmd: {resource: Base, cmd: fail}\n  - wait_s: 1000\n"
    )
    report = abort_at(two, tmp_path, "send_cmd Base fail", body, lambda run: run.abort("enough"))

    assert (report.outcome, outcomes(report)) == ("aborted", {"fast": "aborted", "slow": "aborted"})
    assert {record.outcome for record in report.steps} == {"aborted"}
    assert report.duration_s < 500


def test_a_signal_handler_may_abort(two: Fleet, tmp_path: Path) -> None:
    runs: list[Run] = []

    def handler(*_: object) -> None:
        runs[0].abort("by signal")

    def send(run: Run) -> None:
        runs.append(run)
        signal.raise_signal(signal.SIGUSR1)

    before = signal.signal(signal.SIGUSR1, handler)
    try:
        report = abort_at(two, tmp_path, "send_cmd Base go100", LONG, send)
    finally:
        signal.signal(signal.SIGUSR1, before)

    assert str(report.error and report.error.message) == "aborted: by signal"


SLOW_FINALLY = """\
finally:
  - on: all
    do:
      - send_cmd: {resource: Base, cmd: go99}
      - send_cmd: {resource: Base, cmd: now}
"""


def test_one_abort_during_finally_lets_it_go_on(two: Fleet, tmp_path: Path) -> None:
    body = f"{ON}  - log: x\n" + SLOW_FINALLY.replace("go99", "go9")
    report = abort_at(two, tmp_path, "send_cmd Base go9", body, lambda run: run.abort("enough"))

    assert report.outcome == "aborted"
    assert brief(report, "slow") == [("send_cmd Base go9", "done", 1), ("send_cmd Base now", "done", 1)]


def test_a_second_abort_skips_the_rest_of_finally_but_not_the_halts(two: Fleet, tmp_path: Path) -> None:
    body = f"timeout_s: 500\n{ON}  - log: x\n" + SLOW_FINALLY
    report = abort_at(two, tmp_path, "send_cmd Base go99", body, lambda run: run.abort("enough"), times=2)

    assert report.outcome == "aborted"
    assert brief(report, "slow") == [("send_cmd Base go99", "aborted", 1)]
    assert report.duration_s < 90
    assert ask(two, "slow", "halts") >= 1


def test_an_abort_before_the_start_moves_nothing(two: Fleet, tmp_path: Path) -> None:
    aborted = Run(make_plan(scenario(tmp_path, LONG + FINALLY), two), two)
    aborted.abort("changed my mind")
    report = aborted.start().get()

    assert report.outcome == "aborted"
    assert brief(report, "slow") == [("send_cmd Base fail", "failed", 1), ("send_cmd Base s", "done", 1)]


def test_an_abort_after_the_end_changes_nothing(two: Fleet, tmp_path: Path) -> None:
    over = Run(make_plan(scenario(tmp_path, f"{ON}  - log: x\n"), two), two)
    report = over.start().get()
    over.abort("too late")

    assert report.outcome == "done"


def test_giving_up_the_future_aborts_the_run(two: Fleet, tmp_path: Path) -> None:
    ended = threading.Event()

    def listener(event: Event) -> None:
        if isinstance(event, RunEnded):
            reports.append(event.report)
            ended.set()

    reports: list[Report] = []
    Run(make_plan(scenario(tmp_path, LONG), two), two, None, [listener]).start().cancel()

    assert ended.wait(WAIT_S)
    assert str(reports[0].error and reports[0].error.message) == "aborted: its future was cancelled"


def test_an_error_of_the_engine_fails_the_run_and_halts_the_robots(two: Fleet, tmp_path: Path) -> None:
    body = f"timeout_s: 500\n{ON}  - send_cmd: {{resource: Base, cmd: go100}}\n- on: all\n  do: [{{log: x}}]\n{FINALLY}"
    broken = Run(make_plan(scenario(tmp_path, body), two), two)
    broken._robots["fast"].saved = None  # type: ignore[assignment]
    report = broken.start().get()

    assert report.outcome == "failed"
    assert report.error is not None
    assert report.error.code == "error"
    assert report.error.message.startswith("TypeError: ")
    assert report.duration_s < 90
    assert outcomes(report)["slow"] != "done"
    assert ask(two, "slow", "halts") >= 2
    assert ask(two, "slow", "stops") == 1


def test_a_summary_that_cannot_be_written_is_told(two: Fleet, tmp_path: Path) -> None:
    folder = tmp_path / "run"

    def sabotage(event: Event) -> None:
        if isinstance(event, RunStarted):
            (folder / "events.jsonl").unlink()
            folder.rmdir()

    report = run(two, tmp_path, f"{ON}  - log: x\n", directory=folder, listeners=[sabotage])

    assert report.outcome == "failed"
    assert report.error is not None
    assert "summary.json" in report.error.message


INTERRUPTED = """\
import sys
from pathlib import Path

from eal_actors.facade.fleet import Fleet
from eal_actors.scenario import StepStarted, run_scenario


def tell(event):
    if isinstance(event, StepStarted) and event.label == "send_cmd Base go100":
        print("moving", flush=True)


folder = Path(sys.argv[1])
with Fleet.load(folder / "fleet.yaml") as fleet:
    try:
        run_scenario(folder / "trial.yaml", fleet, directory=folder / "run", listeners=[tell])
    except KeyboardInterrupt:
        print("stops", fleet["slow"]["Base"].send_req("stops").get().value)
        sys.exit(130)
"""


def test_ctrl_c_aborts_runs_finally_and_is_raised_again(two: Fleet, tmp_path: Path) -> None:
    scenario(tmp_path, LONG + FINALLY)
    program = [sys.executable, "-c", INTERRUPTED, str(tmp_path)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "moving\n"
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=WAIT_S)

    assert (process.returncode, output.splitlines()[-1]) == (130, "stops 1")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["outcome"], summary["error"]["message"]) == ("aborted", "aborted: interrupted from the keyboard")


def test_ctrl_c_is_pythons_own_again_after_a_run(two: Fleet, tmp_path: Path) -> None:
    during: list[object] = []
    listener = Watch("send_cmd Base now", lambda: during.append(signal.getsignal(signal.SIGINT)))
    run(two, tmp_path, f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n", listeners=[listener])

    assert during[0] is not signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# Plans.


def test_nothing_moves_when_something_is_wrong(two: Fleet, tmp_path: Path) -> None:
    body = (
        f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n"
        "  - for: {seconds: [1, 101]}\n    do: [{send_cmd: {resource: Base, cmd: 'go${seconds}'}}]\n"
        "  - get_value: {resource: Ear}\n"
    )
    with pytest.raises(ConfigError) as caught:
        run(two, tmp_path, body)

    assert [(problem.line, problem.message) for problem in caught.value.problems] == [
        (11, "fast, slow: command 'go101': its argument must be double 0..100 s, not 101"),
        (12, "fast, slow: unknown resource 'Ear'; known: Base, Eye"),
    ]
    assert ask(two, "fast", "tries") == 0


def test_a_plan_counts_its_calls(two: Fleet, tmp_path: Path) -> None:
    step = "send_cmd: {resource: Base, cmd: now}"
    loop = f"for: {{a: [1, 2]}}\n      do: [{{{step}}}]"
    body = f"steps:\n- repeat: 3\n  do:\n  - on: all\n    do:\n    - {step}\n    - {loop}\n"
    plan = make_plan(scenario(tmp_path, body), two)

    assert (plan.roles, plan.robots, plan.calls) == ({"all": ("fast", "slow")}, ("fast", "slow"), 18)


@pytest.mark.parametrize(("trouble", "reason"), [("is_broken", "unplugged"), ("fails_to_open", "no such port")])
def test_a_robot_that_did_not_start_keeps_the_scenario_from_starting(tmp_path: Path, trouble: str, reason: str) -> None:
    plain = scenario(tmp_path, f"{ON}  - log: x\n")
    broken = {trouble: True}
    with (
        rigs(tmp_path, head="defaults: {max_restarts: 0}", a=broken, b={}, c=broken) as fleet,
        pytest.raises(RobotFailedError) as caught,
    ):
        make_plan(plain, fleet)

    assert caught.value.robot == "a"
    assert reason in caught.value.message
    assert caught.value.message.endswith("; nor did c start")


def test_a_robot_that_did_not_start_is_dropped_where_the_scenario_drops(tmp_path: Path) -> None:
    watch = Watch()
    with rigs(tmp_path, a={"is_broken": True}, b={}) as fleet:
        body = f"on_failure: {{retry: 1, then: drop}}\n{ON}  - send_cmd: {{resource: Base, cmd: now}}\n"
        report = run(fleet, tmp_path, body, listeners=[watch])

        with pytest.raises(RobotFailedError, match="role 'all' needs at least 2 robots"):
            make_plan(scenario(tmp_path, body, HEAD.replace("all: {}", "all: {min: 2}")), fleet)

    assert (report.outcome, outcomes(report)) == ("failed", {"a": "dropped", "b": "done"})
    assert "unplugged" in str(report.robots["a"].error)
    assert [event.robot for event in watch.events if isinstance(event, RobotDropped)] == ["a"]
    assert [event.calls for event in watch.events if isinstance(event, RunStarted)] == [1]


def test_a_fleet_must_be_connected(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}) as fleet:
        pass

    with pytest.raises(RobotNotFoundError, match="is not connected"):
        make_plan(scenario(tmp_path, f"{ON}  - log: x\n"), fleet)
