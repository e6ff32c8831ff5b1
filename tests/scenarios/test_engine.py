from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario import (
    LogLine,
    RobotDropped,
    Run,
    RunEnded,
    RunEvent,
    RunStarted,
    StepEnded,
    StepStarted,
    make_plan,
    summary_schema,
)
from tests.manual_clock import ManualClock
from tests.robots import advance_until_done
from tests.scenarios.rig import HEAD, rigs, scenario
from tests.scenarios.running import ON, THEN_NOW, Watch, outcomes, records, run


def test_robots_move_at_once_and_wait_for_each_other(two: Fleet, tmp_path: Path) -> None:
    report = run(two, tmp_path, f"{ON}  - send_cmd: {{resource: Base, cmd: go9}}\n{THEN_NOW}")
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
    assert [(record.kind, record.command, record.label) for record in first] == [
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
    with pytest.raises(ScenarioError, match="'trial' saves files: give its run a `directory`"):
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
    assert report.wall_started.endswith("+00:00")


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
    assert kinds == [RunStarted, StepStarted, StepEnded, StepStarted, StepEnded, RobotDropped, LogLine, RunEnded]
    started, ended = watch.events[0], watch.events[-1]
    assert isinstance(started, RunStarted)
    assert (started.scenario, started.fleet, started.robots, started.calls) == ("trial", "rigs", ("a",), 2)
    assert isinstance(ended, RunEnded)
    assert ended.report == report
    assert [event.time_s for event in watch.events] == sorted(event.time_s for event in watch.events)


def test_a_listener_that_raises_is_told_no_more(two: Fleet, tmp_path: Path) -> None:
    calls: list[RunEvent] = []

    def clumsy(event: RunEvent) -> None:
        calls.append(event)
        raise SystemExit

    watch = Watch()
    report = run(two, tmp_path, f"{ON}  - send_cmd: {{resource: Base, cmd: now}}\n", listeners=[clumsy, watch])

    assert (report.outcome, len(calls)) == ("done", 1)
    assert len(watch.events) == 6


def test_a_run_overwrites_no_other(two: Fleet, tmp_path: Path) -> None:
    run(two, tmp_path, "steps: [{log: x}]", directory=tmp_path / "run")

    with pytest.raises(ScenarioError, match="already has the record of a run"):
        run(two, tmp_path, "steps: [{log: x}]", directory=tmp_path / "run")


def test_a_run_is_for_once(two: Fleet, tmp_path: Path) -> None:
    once = Run(make_plan(scenario(tmp_path, "steps: [{log: x}]"), two), two)
    once.start().get()

    with pytest.raises(ScenarioError, match="this run was started already"):
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
