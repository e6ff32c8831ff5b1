from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.synchronized_start import DelayMeter
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import LogLine, Report, Run, Signalled, StartedTogether, make_plan
from tests.scenarios.rig import HEAD, rigs, scenario
from tests.scenarios.running import ON, Watch, brief, outcomes, records, run

TWO_ROLES = HEAD.replace("all: {}", "all: {}\n  quick: {tags: [quick]}\n  heavy: {tags: [heavy]}")


def kinds(report: Report, robot: str, kind: str) -> list[tuple[float, float]]:
    return [(record.start_s, record.end_s) for record in records(report, robot) if record.kind == kind]


def test_robots_of_an_on_meet_again_and_again(two: Fleet, tmp_path: Path) -> None:
    body = f"""{ON}
    - repeat: 3
      do:
        - send_cmd: {{resource: Base, cmd: go3}}
        - barrier: here
          timeout_s: 100
"""
    report = run(two, tmp_path, body)

    drives = {robot: kinds(report, robot, "send_cmd") for robot in ("fast", "slow")}
    assert report.outcome == "done"
    for number in (1, 2):
        assert drives["fast"][number][0] >= drives["slow"][number - 1][1]


def test_roles_in_branches_meet_even_before_their_on_begins(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - parallel:
              late:
                - wait_s: 3
                - on: heavy
                  do: [{barrier: b, timeout_s: 100}]
                - wait_s: 1
              early:
                - on: quick
                  do: [{barrier: b, timeout_s: 100}, {log: met}]
        """
    watch = Watch()
    report = run(two, tmp_path, body, TWO_ROLES, listeners=[watch])

    (met,) = [event for event in watch.events if isinstance(event, LogLine)]
    assert report.outcome == "done"
    assert met.time_s >= 3.0


def test_who_is_dropped_or_through_is_waited_for_no_longer(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}, b={}, c={}) as fleet:
        body = f"""on_failure: drop\n{ON}
    - send_cmd: {{resource: Base, cmd: flaky}}
    - if: index == 1
      then: [{{wait_s: 2}}]
      else: [{{barrier: meet, timeout_s: 100}}]
"""
        report = run(fleet, tmp_path, body)

    assert outcomes(report) == {"a": "dropped", "b": "done", "c": "done"}
    (barrier,) = kinds(report, "c", "barrier")
    (wait,) = kinds(report, "b", "wait_s")
    assert barrier[1] >= wait[1]


def test_a_barrier_says_who_did_not_come(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}, b={}, c={}) as fleet:
        body = f"""on_failure: drop\n{ON}
    - if: index > 0
      then: [{{wait_s: 50}}]
    - {{barrier: meet, timeout_s: 2}}
"""
        report = run(fleet, tmp_path, body)

    (record,) = records(report, "a")
    assert (record.outcome, record.kind) == ("dropped", "barrier")
    assert record.error is not None
    assert (record.error.code, record.error.message) == ("deadline", "barrier 'meet': b, c did not come within 2 s")
    assert outcomes(report) == {"a": "dropped", "b": "done", "c": "done"}


def test_signals_are_latched_counted_and_carry_a_value(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - parallel:
              giver:
                - on: quick
                  do:
                    - signal: ready
                      value: "${2 + 3}"
                    - wait_s: 2
                    - signal: done
                    - signal: done
              taker:
                - wait_s: 1
                - on: heavy
                  do:
                    - {wait_for: ready, timeout_s: 100, save_as: found}
                    - {wait_for: done, count: "${1 + 1}", timeout_s: 100, save_as: who}
                    - log: "${found} by ${who}"
        """
    watch = Watch()
    report = run(two, tmp_path, body, TWO_ROLES, listeners=[watch])

    assert report.outcome == "done"
    assert [event.text for event in watch.events if isinstance(event, LogLine)] == ["5 by fast"]
    given = [event for event in watch.events if isinstance(event, Signalled)]
    signals = [(event.robot, event.name, event.count, event.value) for event in given]
    assert signals == [("fast", "ready", 1, 5), ("fast", "done", 1, "fast"), ("fast", "done", 2, "fast")]


def test_a_wait_for_a_signal_has_an_end(two: Fleet, tmp_path: Path) -> None:
    body = f"{ON}  - if: index > 5\n    then: [{{signal: x}}]\n  - {{wait_for: x, count: 2, timeout_s: 1}}\n"
    report = run(two, tmp_path, body)

    assert report.outcome == "failed"
    assert report.error is not None
    assert report.error.message == "signal 'x' was not given within 1 s; it was given 0 of 2 times"


def test_robots_begin_together_however_late_one_comes(tmp_path: Path) -> None:
    watch = Watch()
    with rigs(tmp_path, clock=LockStepClock(), a={"slowness": 0.1}, b={}, c={}) as fleet:
        body = f"""{ON}
    - send_cmd: {{resource: Base, cmd: go5}}
    - repeat: 2
      do: [{{send_cmd: {{resource: Base, cmd: go1}}, together: true}}]
"""
        report = run(fleet, tmp_path, body, listeners=[watch])

    starts = [event.start for event in watch.events if isinstance(event, StartedTogether)]
    assert report.outcome == "done"
    assert list(report.starts) == starts
    assert [start.step for start in starts] == ["steps[0].do[1].do[0]"] * 2
    for start in starts:
        assert set(start.begins) == {"a", "b", "c"}
        assert start.skew_s is not None
        assert start.skew_s < 1e-6
        assert start.start_s >= 5.0


def test_who_fails_before_a_start_together_keeps_nobody_waiting(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 1}, b={}, c={}) as fleet:
        body = f"""on_failure: drop\n{ON}
    - send_cmd: {{resource: Base, cmd: flaky}}
    - {{send_cmd: {{resource: Base, cmd: now}}, together: true}}
"""
        report = run(fleet, tmp_path, body)

    assert outcomes(report) == {"a": "dropped", "b": "done", "c": "done"}
    (start,) = report.starts
    assert set(start.begins) == {"b", "c"}


def test_robots_that_wait_for_each_other_in_different_steps_fail(tmp_path: Path) -> None:
    """They stood still for ever."""
    with rigs(tmp_path, clock=LockStepClock(), a={}, b={}) as fleet:
        body = f"""{ON}
    - if: index == 0
      then: [{{send_cmd: {{resource: Base, cmd: now}}, together: true}}]
      else: [{{send_cmd: {{resource: Base, cmd: go1}}, together: true}}]
"""
        report = Run(make_plan(scenario(tmp_path, body), fleet), fleet).start().get(timeout=10_000)

    assert report.outcome == "failed"
    assert report.error is not None
    assert report.error.message == (
        "b did not come to this step with `together` within 600 s: all robots must begin by the same step"
    )


def test_a_command_that_fails_before_the_common_start_does_not_end_before_its_begin(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}, b={}) as fleet:
        fleet.stop("kept still").get()
        report = run(fleet, tmp_path, f"{ON}    - {{send_cmd: {{resource: Base, cmd: now}}, together: true}}\n")

    assert report.outcome == "aborted"
    assert [record.outcome for record in report.steps] == ["aborted", "aborted"]
    assert all(record.start_s <= record.end_s for record in report.steps)


def test_a_command_that_fails_together_is_tried_again_alone(tmp_path: Path) -> None:
    with rigs(tmp_path, a={"failures": 2}, b={}) as fleet:
        body = f"""{ON}
    - {{send_cmd: {{resource: Base, cmd: flaky}}, together: true, on_failure: {{retry: 2, back_off_s: 0.1}}}}
"""
        report = run(fleet, tmp_path, body)

    assert report.outcome == "done"
    assert brief(report, "a") == [("send_cmd Base flaky", "done", 3)]
    assert len(report.starts) == 1


@pytest.mark.parametrize("step", ["barrier: x\n    timeout_s: 1000", "wait_for: x\n    timeout_s: 1000"])
def test_an_abort_ends_every_wait(two: Fleet, tmp_path: Path, step: str) -> None:
    fails = "[{send_cmd: {resource: Base, cmd: fail}}, {signal: x}]"
    body = f"timeout_s: 500\n{ON}  - if: index == 0\n    then: {fails}\n  - {step}\n"
    report = run(two, tmp_path, body)

    assert outcomes(report) == {"fast": "failed", "slow": "aborted"}
    assert records(report, "slow")[0].outcome == "aborted"
    assert report.duration_s < 100


def test_a_spare_that_takes_over_a_command_begins_it_alone_and_is_there_for_the_next(tmp_path: Path) -> None:
    head = HEAD.replace("all: {}", "all: {spares: 1, on_failure: substitute}")
    with rigs(tmp_path, clock=LockStepClock(), a={"failures": 1}, b={}, c={}) as fleet:
        body = f"""{ON}
    - {{send_cmd: {{resource: Base, cmd: flaky}}, together: true}}
    - {{send_cmd: {{resource: Base, cmd: now}}, together: true}}
"""
        report = run(fleet, tmp_path, body, head)

    assert outcomes(report) == {"a": "replaced", "b": "done", "c": "done"}
    assert [set(start.begins) for start in report.starts] == [{"a", "b"}, {"b", "c"}]


def test_a_start_is_reported_although_a_value_of_a_robot_cannot_be_sent(two: Fleet, tmp_path: Path) -> None:
    body = f"""on_failure: skip\n{ON}
    - let: {{x: "[1, 'a'] if index else 3"}}
    - {{set_value: {{resource: Base, value: "${{x}}"}}, together: true}}
"""
    report = run(two, tmp_path, body)

    assert [record.outcome for record in report.steps] == ["skipped", "done"]
    (start,) = report.starts
    assert [begin is None for begin in start.begins.values()] == [True, False]


def test_a_robot_that_leaves_while_a_start_is_agreed_leaves_the_others_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with rigs(tmp_path, clock=LockStepClock(), a={}, b={}) as fleet:
        monkeypatch.setattr(DelayMeter, "ping", lambda _: [Future(fleet.clock)])  # nobody answers for 0.5 s
        body = f"""on_failure: drop\n{ON}
    - parallel:
        - - {{send_cmd: {{resource: Base, cmd: now}}, together: true}}
        - - wait_s: 0.1
          - expect: index == 1
"""
        report = run(fleet, tmp_path, body)

    assert outcomes(report) == {"a": "dropped", "b": "done"}
    assert brief(report, "b")[-1] == ("send_cmd Base now", "done", 1)


def test_loops_leave_nothing_behind(tmp_path: Path) -> None:
    """Meetings, signals and parts of passes that are over take no memory."""
    part = "steps:\n- signal: here\n- on: all\n  do: [{barrier: inside, timeout_s: 1}]\n"
    (tmp_path / "part.yaml").write_text(HEAD + part)
    body = """steps:
- repeat: 30
  do:
    - scenario: part.yaml
    - if: 1 == 1
      then: [{wait_for: never, timeout_s: 0.01, default: 0}]
    - on: all
      until: never
      do:
        - sequence: [{barrier: outside, timeout_s: 1}]
          timeout_s: 5
- if: 1 == 2
  then: [{signal: never}]
"""
    with rigs(tmp_path, clock=LockStepClock(), a={}, b={}) as fleet:
        over = Run(make_plan(scenario(tmp_path, body), fleet), fleet)
        assert over.start().get().outcome == "done"

    context = over._run
    frames = {frame for frame, _ in (*context.signals.counts, *context.signals.values)}
    assert frames <= {context.main}
    assert not [futures for futures in context.signals._waiting.values() if futures]
    assert len(context.barriers._expected) <= 1
    assert not context.barriers._inside
    assert len(context.main.meets) < 20
