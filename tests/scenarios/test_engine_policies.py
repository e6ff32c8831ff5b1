from __future__ import annotations

from pathlib import Path

from eal_actors.facade.fleet import Fleet
from eal_actors.scenario import LogLine, RobotReplaced, StepRetried
from tests.scenarios.rig import HEAD, ask, rigs
from tests.scenarios.running import ON, Watch, brief, outcomes, records, run, run_rigs

FLAKY = "  - send_cmd: {resource: Base, cmd: flaky}\n"
NOW = "  - send_cmd: {resource: Base, cmd: now}\n"


def test_a_step_that_may_be_skipped_is_and_the_record_tells(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}, b={}) as fleet:
        report = run(fleet, tmp_path, f"on_failure: skip\n{ON}{FLAKY}{NOW}")

    assert (report.outcome, outcomes(report)) == ("done", {"a": "done", "b": "done"})
    assert brief(report, "a") == [("send_cmd Base flaky", "skipped", 1), ("send_cmd Base now", "done", 1)]
    assert records(report, "a")[0].error is not None


def test_the_back_off_grows(tmp_path: Path) -> None:
    watch = Watch()
    body = f"on_failure: {{retry: 3, back_off_s: 1, factor: 2}}\n{ON}{FLAKY}"
    report = run_rigs(tmp_path, body, [watch], a={"failures": 3})

    assert report.outcome == "done"
    times_s = [event.time_s for event in watch.events if isinstance(event, StepRetried)]
    assert times_s[1] - times_s[0] >= 1.0
    assert times_s[2] - times_s[1] >= 2.0
    assert report.steps[0].end_s - times_s[2] >= 4.0


def test_the_nearest_policy_counts(tmp_path: Path) -> None:
    head = HEAD.replace("all: {}", "all: {on_failure: skip}")
    with rigs(tmp_path, a={}, b={}) as fleet:
        body = f"""{ON}
    - send_cmd: {{resource: Base, cmd: fail}}
    - repeat: 1
      on_failure: {{retry: 1, then: skip}}
      do:
        - send_cmd: {{resource: Base, cmd: fail}}
        - send_cmd: {{resource: Base, cmd: fail}}
          on_failure: {{retry: 2, then: skip}}
"""
        report = run(fleet, tmp_path, body, head)

    assert report.outcome == "done"
    assert [(record.kind, record.attempts) for record in records(report, "a")] == [
        ("send_cmd", 1),
        ("send_cmd", 1),
        ("send_cmd", 1),
        ("repeat", 2),
    ]


def test_a_run_does_not_go_on_with_too_few(tmp_path: Path) -> None:
    watch = Watch()
    head = HEAD.replace("all: {}", "all: {min: 2}")
    with rigs(tmp_path, a={"failures": 1}, b={"failures": 1}, c={}) as fleet:
        body = f"on_failure: drop\n{ON}{FLAKY}  - wait_s: 1000\n"
        report = run(fleet, tmp_path, body, head, listeners=[watch])

    assert (report.outcome, outcomes(report)) == ("failed", {"a": "dropped", "b": "dropped", "c": "aborted"})
    assert "role 'all' is left with 1 of the 2 robots that it needs" in [
        event.text for event in watch.events if isinstance(event, LogLine)
    ]
    assert report.duration_s < 500


SPARES = HEAD.replace("all: {}", "all: {spares: 1, min: 2}")


def test_a_spare_takes_the_place_and_goes_on_from_the_step_that_failed(tmp_path: Path) -> None:
    watch = Watch()
    with rigs(tmp_path, a={}, b={"failures": 2}, c={}) as fleet:
        body = f"""on_failure: substitute\n{ON}
    - send_cmd: {{resource: Base, cmd: now}}
    - let: {{x: index + 10}}
    - send_cmd: {{resource: Base, cmd: flaky}}
    - {{barrier: meet, timeout_s: 100}}
    - log: "${{robot}} ${{index}} of ${{count}}, x ${{x}}"
finally:
  - on: all
    do: [{{send_cmd: {{resource: Base, cmd: s}}}}]
"""
        report = run(fleet, tmp_path, body, SPARES, listeners=[watch])
        stops = [ask(fleet, robot, "stops") for robot in fleet]

    assert (report.outcome, outcomes(report)) == ("done", {"a": "done", "b": "replaced", "c": "done"})
    assert brief(report, "b")[:2] == [("send_cmd Base now", "done", 1), ("send_cmd Base flaky", "replaced", 1)]
    assert brief(report, "c")[:2] == [("send_cmd Base flaky", "done", 1), ("barrier meet", "done", 1)]
    lines = {(event.robot, event.text) for event in watch.events if isinstance(event, LogLine)}
    assert lines == {("a", "a 0 of 2, x 10"), ("c", "c 1 of 2, x 11")}
    (replaced,) = [event for event in watch.events if isinstance(event, RobotReplaced)]
    assert (replaced.robot, replaced.by, replaced.role) == ("b", "c", "all")
    assert stops == [1, 1, 1], "every robot that took part performs finally"


def test_without_a_spare_left_the_robot_is_dropped(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}, b={}, c={"failures": 1}) as fleet:
        report = run(fleet, tmp_path, f"on_failure: substitute\n{ON}{FLAKY}{NOW}", SPARES.replace("min: 2", "min: 1"))

    assert (report.outcome, outcomes(report)) == ("done", {"a": "replaced", "b": "done", "c": "dropped"})


def test_a_spare_that_is_not_needed_is_told_so(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}, b={}, c={}) as fleet:
        report = run(fleet, tmp_path, f"on_failure: substitute\n{ON}{NOW}", SPARES)

    assert (report.outcome, outcomes(report)) == ("done", {"a": "done", "b": "done", "c": "spare"})
    assert report.roles == {"all": ["a", "b"]}


def test_a_spare_takes_the_place_of_a_robot_that_did_not_start(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"is_broken": True}, b={}, c={}) as fleet:
        report = run(fleet, tmp_path, f"on_failure: substitute\n{ON}{NOW}", SPARES)

    assert (report.outcome, outcomes(report)) == ("done", {"a": "replaced", "b": "done", "c": "done"})


def test_a_robot_dropped_in_one_branch_ends_its_others(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}, b={}) as fleet:
        body = f"""timeout_s: 500\non_failure: drop\n{ON}
    - parallel:
        - [{{wait_s: 1}}, {{if: index == 0, then: [{{send_req: {{resource: Eye, req: name}}}}, {{expect: "1 == 2"}}]}}]
        - [{{send_cmd: {{resource: Base, cmd: go10}}}}]
"""
        report = run(fleet, tmp_path, body)

    assert outcomes(report) == {"a": "dropped", "b": "done"}
    assert {record.label: record.outcome for record in records(report, "a")}["send_cmd Base go10"] == "dropped"
    assert report.duration_s < 100


def test_the_default_is_to_abort(two: Fleet, tmp_path: Path) -> None:
    assert run(two, tmp_path, f"{ON}  - expect: index == 0\n").outcome == "failed"
