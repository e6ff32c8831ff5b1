from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.scenario import LogLine, Report
from tests.scenarios.rig import HEAD, ask, rigs
from tests.scenarios.running import ON, Watch, brief, outcomes, records, run


def logs(watch: Watch) -> list[tuple[str | None, str]]:
    return [(event.robot, event.text) for event in watch.events if isinstance(event, LogLine)]


def said(fleet: Fleet, folder: Path, body: str, head: str = HEAD) -> tuple[Report, list[tuple[str | None, str]]]:
    watch = Watch()
    report = run(fleet, folder, body, head, listeners=[watch])
    return report, logs(watch)


TWO_ROLES = HEAD.replace("all: {}", "all: {}\n  quick: {tags: [quick]}\n  heavy: {tags: [heavy]}")


def test_branches_go_on_at_once_and_are_waited_for(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - parallel:
              left: [{on: quick, do: [{send_cmd: {resource: Base, cmd: go5}}]}]
              right:
                - on: heavy
                  do: [{send_cmd: {resource: Base, cmd: go5}}]
                - log: right is through
          - log: all are through
        """
    report, lines = said(two, tmp_path, body, TWO_ROLES)

    fast, slow = records(report, "fast")[0], records(report, "slow")[0]
    assert report.outcome == "done"
    assert slow.start_s < fast.end_s < slow.end_s
    assert (fast.branch, slow.branch) == ("left", "right")
    assert (fast.step, fast.role) == ("steps[0].parallel.left[0].do[0]", "quick")
    assert lines == [(None, "right is through"), (None, "all are through")]


def test_branches_of_one_robot(two: Fleet, tmp_path: Path) -> None:
    body = f"""{ON}
    - parallel:
        - [{{send_cmd: {{resource: Base, cmd: go9}}}}]
        - [{{get_value: {{resource: Eye}}}}, {{get_value: {{resource: Eye}}}}]
"""
    report = run(two, tmp_path, body)

    drive, first, second = sorted(records(report, "slow"), key=lambda record: record.start_s)
    assert report.outcome == "done"
    assert second.end_s < drive.end_s
    assert (drive.branch, first.branch) == ("0", "1")


def test_until_first_halts_the_others_who_go_on_after_it(two: Fleet, tmp_path: Path) -> None:
    body = """
        timeout_s: 500
        steps:
          - on: all
            until: first
            do: [{send_cmd: {resource: Base, cmd: go100}}, {log: "${robot} was first"}]
          - on: all
            do: [{send_cmd: {resource: Base, cmd: now}}]
        """
    report, lines = said(two, tmp_path, body)

    assert (report.outcome, outcomes(report)) == ("done", {"fast": "done", "slow": "done"})
    assert lines == [("fast", "fast was first")]
    assert brief(report, "slow") == [("send_cmd Base go100", "stopped", 1), ("send_cmd Base now", "done", 1)]
    assert report.duration_s < 90
    assert ask(two, "slow", "halts") >= 2, "when it was stopped, and at the end"


def test_until_a_signal(two: Fleet, tmp_path: Path) -> None:
    body = """
        timeout_s: 500
        steps:
          - parallel:
              search:
                - on: heavy
                  until: found
                  do: [{send_cmd: {resource: Base, cmd: go100}}, {signal: found}]
                - log: search is over
              other: [{on: quick, do: [{send_cmd: {resource: Base, cmd: go5}}, {signal: found, value: 7}]}]
        """
    report, lines = said(two, tmp_path, body, TWO_ROLES)

    assert report.outcome == "done"
    assert brief(report, "slow") == [("send_cmd Base go100", "stopped", 1)]
    assert lines == [(None, "search is over")]
    assert report.duration_s < 90


def test_conditions_and_loops_by_expressions(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - let: {most: 2, found: "[1, 2, 3]"}
          - on: all
            do:
              - if: index == 0
                then: [{log: "first of ${count}"}]
                else: [{log: "number ${index} in ${role}"}]
              - let: {x: 0}
              - while: x < most
                limit: 10
                do: [{let: {x: x + 1}}, {log: "round ${i}, x ${x}"}]
          - for: {n: "${found}"}
            do: [{log: "n ${n * 2}"}]
          - repeat: "${len(found) - 1}"
            do: [{log: "i ${i}"}]
        """
    report, lines = said(two, tmp_path, body)

    assert report.outcome == "done"
    assert [text for robot, text in lines if robot == "fast"] == ["first of 2", "round 0, x 1", "round 1, x 2"]
    assert [text for robot, text in lines if robot == "slow"] == ["number 1 in all", "round 0, x 1", "round 1, x 2"]
    assert [text for robot, text in lines if robot is None] == ["n 2", "n 4", "n 6", "i 0", "i 1"]
    assert report.steps == (), "none of these takes time"


def test_readings_decide(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - on: all
            do:
              - while: value('Base') < 3
                limit: 5
                do: [{set_value: {resource: Base, value: "${value('Base') + 1}"}}]
              - expect: request('Base', 'tries')
                equals: 0
              - log: "${value('Base')} ${config('Base', 'gain')}"
        """
    report, lines = said(two, tmp_path, body)

    assert report.outcome == "done", report.error
    assert brief(report, "fast")[:3] == [(f"set_value Base {n}", "done", 1) for n in (1, 2, 3)]
    assert sorted(lines) == [("fast", "3 1"), ("slow", "3 1")]


def test_a_loop_that_reaches_its_limit_fails_unless_it_may_go_on(two: Fleet, tmp_path: Path) -> None:
    loop = "  - while: 'true'\n    limit: 3\n    do: [{log: x}]\n"
    report, lines = said(two, tmp_path, f"on_failure: drop\n{ON}{loop}")
    assert report.outcome == "failed"
    assert str(report.error and report.error.message) == "true is still true after 3 rounds, the limit"
    assert report.steps[0].step == "steps[0].do[0].while"
    assert len([line for line in lines if line[1] == "x"]) == 6

    report, lines = said(two, tmp_path, f"{ON}{loop}    at_limit: go_on\n")
    assert report.outcome == "done"
    assert len(lines) == 6


def test_a_loop_without_waits_lets_others_have_their_turn(two: Fleet, tmp_path: Path) -> None:
    report = run(
        two, tmp_path, "timeout_s: 100\nsteps: [{parallel: [[{repeat: 20000, do: [{let: {x: i}}]}], [{wait_s: 0.1}]]}]"
    )

    assert report.outcome == "done"
    (wait,) = report.steps
    assert wait.end_s < report.duration_s / 2


@pytest.mark.parametrize(
    ("expect", "message"),
    [
        ("expect: value('Base') == 1", "expected value('Base') == 1 to be true, but value('Base') is 0"),
        ("expect: value('Base')\n    equals: 1", "expected value('Base') to be 1, but it is 0"),
        (
            "expect: config('Base', 'gain')\n    equals: 0.5\n    tolerance: 0.25\n    says: gain of ${robot}",
            "gain of a: expected config('Base', 'gain') to be 0.5 ± 0.25, but it is 1",
        ),
        ("expect: '[1, 2]'\n    equals: [1, 3]", "expected [1, 2] to be [1, 3], but it is [1, 2]"),
    ],
)
def test_an_expectation_that_fails_says_what_was_seen(tmp_path: Path, expect: str, message: str) -> None:
    with rigs(tmp_path, a={}) as fleet:
        report = run(fleet, tmp_path, f"{ON}  - {expect}\n")

    (record,) = report.steps
    assert (report.outcome, record.outcome, record.kind) == ("failed", "failed", "expect")
    assert record.error is not None
    assert record.error.message == message


def test_expectations_that_hold(two: Fleet, tmp_path: Path) -> None:
    body = f"""{ON}
    - {{expect: "config('Base', 'gain')", equals: 0.9, tolerance: 0.1}}
    - {{expect: "[1.05, 2]", equals: [1, 2], tolerance: 0.1}}
    - {{expect: robot, equals: "${{robot}}"}}
    - {{expect: index + 1, equals: 2 - 1 + index, tolerance: 0.1}}
    - {{expect: "[robot, 'text']", equals: [robot, "'text'"]}}
    - expect: value('Base') in [0, 1] and not false
"""
    report = run(two, tmp_path, body)

    assert report.outcome == "done", report.error
    assert {record.outcome for record in report.steps} == {"done"}


def test_a_wait_for_a_reading(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - on: all
            do:
              - parallel:
                  - [{wait_s: 2}, {set_value: {resource: Base, value: 5}}]
                  - [{wait_until: value('Base') > 3, timeout_s: 100, poll_s: 0.5}, {log: seen}]
        """
    report, lines = said(two, tmp_path, body)

    assert report.outcome == "done"
    assert sorted(lines) == [("fast", "seen"), ("slow", "seen")]
    waits = [record for record in report.steps if record.kind == "wait_until"]
    assert all(2.0 <= record.end_s - record.start_s < 20.0 for record in waits)


def test_a_wait_for_a_reading_has_an_end(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}) as fleet:
        report = run(fleet, tmp_path, f"{ON}  - wait_until: value('Base') > 3\n    timeout_s: 1\n")

    assert report.error is not None
    assert (report.error.code, report.error.message) == (
        "deadline",
        "value('Base') > 3 did not become true within 1 s, but value('Base') is 0",
    )


def test_what_goes_wrong_outside_of_any_robot_fails_the_run(two: Fleet, tmp_path: Path) -> None:
    report = run(two, tmp_path, "steps: [{let: {x: 0}}, {expect: x == 1}, {log: never}]")

    (record,) = report.steps
    assert (report.outcome, record.robot, record.outcome) == ("failed", None, "failed")
    assert outcomes(report) == {"fast": "done", "slow": "done"}, "no step was theirs"
    assert str(report.error and report.error.message) == "expected x == 1 to be true, but x is 0"


def test_csv_grows_by_a_row_for_each_reading(two: Fleet, tmp_path: Path) -> None:
    body = f"""{ON}
    - repeat: 3
      do: [{{set_value: {{resource: Base, value: "${{i}}"}}}}, {{get_value: {{resource: Base}}, save: base.csv}}]
    - {{send_req: {{resource: Eye, req: frame}}, save: deep/frame.csv}}
"""
    assert run(two, tmp_path, body, directory=tmp_path / "run").outcome == "done"

    lines = (tmp_path / "run/slow/base.csv").read_text().splitlines()
    assert [lines[0], *(line.partition(",")[2] for line in lines[1:])] == ["time_s,value", "0", "1", "2"]
    times_s = [float(line.partition(",")[0]) for line in lines[1:]]
    assert times_s == sorted(times_s)
    assert (tmp_path / "run/slow/deep/frame.csv").read_text().splitlines()[0] == "time_s,value_0,value_1"


def test_stopping_a_branch_leaves_the_other_branches_of_its_robot_alone(two: Fleet, tmp_path: Path) -> None:
    body = f"""{ON}
    - parallel:
        - [{{send_cmd: {{resource: Base, cmd: go9}}}}]
        - - parallel:
              - [{{wait_s: 0.2}}]
              - [{{wait_s: 1000}}]
            until: first
"""
    report = run(two, tmp_path, body)

    outcomes_of = {record.label: record.outcome for record in records(report, "slow")}
    assert report.outcome == "done"
    assert outcomes_of == {"send_cmd Base go9": "done", "wait_s 0.2": "done", "wait_s 1000": "stopped"}


def test_what_is_cancelled_ends_in_the_order_in_which_it_began(tmp_path: Path) -> None:
    names = [f"r{number}" for number in range(12)]
    body = "steps:\n  - parallel:\n      - [{wait_s: 1}, {signal: over}]\n      - - on: all\n          until: over\n"
    body += "          do: [{parallel: [[{wait_s: 1000}], [{wait_s: 2000}], [{wait_s: 3000}]]}]\n"
    robots: dict[str, Any] = {name: {} for name in names}
    with rigs(tmp_path, **robots) as fleet:
        report = run(fleet, tmp_path, body)
    stopped = [(record.robot, record.label) for record in report.steps if record.outcome == "stopped"]
    assert stopped == [(name, f"wait_s {seconds}") for name in names for seconds in (1000, 2000, 3000)]


def test_a_formation_of_a_role_without_robots_is_over_at_once(two: Fleet, tmp_path: Path) -> None:
    head = HEAD.replace("all: {}", "all: {}\n  none: {needs: {Camera: []}, min: 0}")
    report = run(two, tmp_path, "steps: [{formation: {role: none, shape: line, spacing_m: 1}}]\n", head)

    assert report.outcome == "done", report.error
