"""Timeouts of blocks, and waits that continue after their timeout."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import LogLine, Report
from tests.scenarios.rig import HEAD, ask, rigs
from tests.scenarios.running import Watch, brief, outcomes, run

ROLES = HEAD.replace("all: {}", "all: {}\n  quick: {tags: [quick]}\n  heavy: {tags: [heavy]}")
BLOCKS = [
    "sequence: [{send_cmd: {resource: Base, cmd: go9}}]",
    "repeat: 3\n      do: [{send_cmd: {resource: Base, cmd: go9}}]",
    "for: {n: [9, 8]}\n      do: [{send_cmd: {resource: Base, cmd: 'go${n}'}}]",
    "while: 'true'\n      limit: 3\n      do: [{send_cmd: {resource: Base, cmd: go9}}]",
    "if: 'true'\n      then: [{send_cmd: {resource: Base, cmd: go9}}]",
    "parallel: [[{send_cmd: {resource: Base, cmd: go9}}], [{wait_s: 1}]]",
]


def texts(watch: Watch) -> list[str]:
    return sorted(event.text for event in watch.events if isinstance(event, LogLine))


def failed_steps(report: Report) -> list[tuple[str | None, str, str, str]]:
    return [
        (record.robot, record.kind, record.outcome, record.error.message)
        for record in report.steps
        if record.error is not None and record.error.code == "deadline"
    ]


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.partition(":")[0])
def test_a_block_that_takes_too_long_is_stopped_and_has_failed(two: Fleet, tmp_path: Path, block: str) -> None:
    watch = Watch()
    body = f"""steps:
- on: all
  do:
    - {block}
      timeout_s: 4
      on_failure: skip
    - log: "${{robot}} goes on"
"""
    report = run(two, tmp_path, body, listeners=[watch])

    kind = block.partition(":")[0]
    assert report.outcome == "done", report.error
    assert ("slow", kind, "skipped", f"{kind} did not end within 4 s") in failed_steps(report)
    assert texts(watch) == ["fast goes on", "slow goes on"]
    assert ("send_cmd Base go9", "stopped", 1) in brief(report, "slow")
    assert ask(two, "slow", "halts") >= 1
    (late,) = [record for record in report.steps if record.robot == "slow" and record.kind == kind]
    assert late.end_s - late.start_s >= 4


def test_each_robot_of_an_on_has_its_own_time_out(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - on: all
            timeout_s: 4
            on_failure: drop
            do: [{send_cmd: {resource: Base, cmd: go9}}]
          - on: all
            do: [{send_cmd: {resource: Base, cmd: now}}]
        """
    report = run(two, tmp_path, body)

    assert (report.outcome, outcomes(report)) == ("done", {"fast": "done", "slow": "dropped"})
    assert brief(report, "fast") == [("send_cmd Base go9", "done", 1), ("send_cmd Base now", "done", 1)]
    error = report.robots["slow"].error
    assert error is not None
    assert error.message == "on did not end within 4 s"


def test_a_block_that_failed_is_tried_again(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}) as fleet:
        body = """
            steps:
              - let: {tries: 0}
              - on: all
                do:
                  - sequence:
                      - send_req: {resource: Base, req: tries}
                        save_as: before
                      - send_cmd: {resource: Base, cmd: now}
                      - if: before == 0
                        then: [{wait_s: 50}]
                    timeout_s: 3
                    on_failure: {retry: 2, then: abort}
            """
        report = run(fleet, tmp_path, body)
        assert report.outcome == "done", report.error
        assert ask(fleet, "a", "tries") == 2


def test_a_spare_begins_the_block_anew(tmp_path: Path) -> None:
    head = HEAD.replace("all: {}", "all: {spares: 1}")
    with rigs(tmp_path, slow={"slowness": 10}, ready={}) as fleet:
        step = "{on: all, timeout_s: 4, on_failure: substitute, do: [{send_cmd: {resource: Base, cmd: go2}}]}"
        body = f"steps: [{step}]\n"
        report = run(fleet, tmp_path, body, head)
        assert outcomes(report) == {"slow": "replaced", "ready": "done"}


def test_a_block_of_the_run_drops_who_is_at_work_in_it(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - parallel:
              quick: [{on: quick, do: [{send_cmd: {resource: Base, cmd: go9}}]}]
              heavy: [{on: heavy, do: [{send_cmd: {resource: Base, cmd: go9}}]}]
            timeout_s: 4
            on_failure: drop
          - on: all
            do: [{send_cmd: {resource: Base, cmd: now}}]
        """
    head = ROLES.replace("heavy: {tags: [heavy]}", "heavy: {tags: [heavy], min: 0}")
    report = run(two, tmp_path, body, head)

    assert (report.outcome, outcomes(report)) == ("done", {"fast": "done", "slow": "dropped"})
    assert brief(report, "fast")[-1] == ("send_cmd Base now", "done", 1)
    assert failed_steps(report)[-1] == (None, "parallel", "dropped", "parallel did not end within 4 s")


def test_a_block_of_the_run_ends_it_by_itself(two: Fleet, tmp_path: Path) -> None:
    body = "steps: [{sequence: [{on: heavy, do: [{send_cmd: {resource: Base, cmd: go9}}]}], timeout_s: 2}]"
    report = run(two, tmp_path, body, ROLES)

    assert (report.outcome, outcomes(report)) == ("failed", {"fast": "done", "slow": "aborted"})
    assert report.duration_s < 9


def test_blocks_inside_each_other_and_a_barrier_in_them(two: Fleet, tmp_path: Path) -> None:
    watch = Watch()
    body = """
        steps:
          - on: all
            timeout_s: 50
            do:
              - sequence:
                  - repeat: 2
                    timeout_s: "${40 if robot == 'fast' else 45}"
                    do:
                      - barrier: there
                        timeout_s: 30
                      - send_cmd: {resource: Base, cmd: go1}
                        together: true
                timeout_s: 48
              - log: through
        """
    report = run(two, tmp_path, body, listeners=[watch])

    assert report.outcome == "done", report.error
    assert texts(watch) == ["through", "through"]
    assert len(report.starts) == 2
    assert all(len(start.begins) == 2 for start in report.starts)


def test_a_part_that_takes_too_long_comes_to_its_own_end(two: Fleet, tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(
        "version: 1\nname: part\nroles: {movers: {}}\n"
        "steps: [{on: movers, do: [{send_cmd: {resource: Base, cmd: go9}}]}]\n"
        "finally: [{on: movers, do: [{send_cmd: {resource: Base, cmd: s}}]}]\n"
    )
    body = """
        steps:
          - scenario: part.yaml
            roles: {movers: all}
            timeout_s: 3
            on_failure: skip
          - on: all
            do: [{send_cmd: {resource: Base, cmd: now}}]
        """
    report = run(two, tmp_path, body)

    assert report.outcome == "done", report.error
    labels = [label for label, _, _ in brief(report, "slow")]
    assert labels == ["send_cmd Base go9", "send_cmd Base s", "send_cmd Base now"]


def test_a_pause_does_not_use_up_the_time_of_a_block(two: Fleet, tmp_path: Path) -> None:
    from eal_actors.scenario import Run, make_plan
    from tests.scenarios.rig import scenario

    body = "steps: [{sequence: [{wait_s: 1}, {wait_s: 1}], timeout_s: 6}]"
    with rigs(tmp_path, a={}) as fleet:
        run_of = Run(make_plan(scenario(tmp_path, body), fleet), fleet)
        run_of.pause()
        future = run_of.start()
        fleet.clock.sleep(10)
        run_of.resume()
        assert future.get().outcome == "done"


def test_a_wait_that_goes_on_without_its_signal(two: Fleet, tmp_path: Path) -> None:
    watch = Watch()
    body = """
        steps:
          - on: all
            do:
              - wait_for: found
                timeout_s: 1
                default: "nobody but ${robot}"
                save_as: who
              - log: "${who}"
              - if: robot == 'never'
                then: [{signal: found}]
        """
    report = run(two, tmp_path, body, listeners=[watch])

    assert report.outcome == "done", report.error
    assert texts(watch) == ["nobody but fast", "nobody but slow"]
    assert report.robots["fast"].variables == {"who": "nobody but fast"}


def test_the_variables_of_the_end_are_told(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - let: {best: 3, word: "'x'"}
          - on: all
            do:
              - get_value: {resource: Base}
                save_as: number
              - get_value: {resource: Eye}
                save_as: picture
              - let: {twice: 2 * number}
        """
    report = run(two, tmp_path, body, directory=tmp_path / "run")

    assert report.variables == {"best": 3, "word": "x"}
    assert report.robots["slow"].variables["twice"] == 0
    assert report.robots["slow"].variables["picture"][0][0] == [200, 0, 0], "small enough to be told"


def test_robots_that_had_finished_are_done_though_the_run_failed(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - on: quick
            do: [{send_cmd: {resource: Base, cmd: now}}]
          - expect: 1 == 2
          - on: heavy
            do: [{send_cmd: {resource: Base, cmd: now}}]
        """
    report = run(two, tmp_path, body, ROLES)

    assert (report.outcome, outcomes(report)) == ("failed", {"fast": "done", "slow": "aborted"})


def test_who_is_at_work_when_another_fails_is_not_done(two: Fleet, tmp_path: Path) -> None:
    body = """
        steps:
          - parallel:
              - [{on: quick, do: [{send_cmd: {resource: Base, cmd: fail}}]}]
              - [{on: heavy, do: [{send_cmd: {resource: Base, cmd: go9}}]}]
          - log: never
        """
    report = run(two, tmp_path, body, ROLES)

    assert (report.outcome, outcomes(report)) == ("failed", {"fast": "failed", "slow": "aborted"})


@pytest.mark.parametrize("timeout_s", [0.7, 1, 3.3])
def test_a_wait_ends_on_a_clock_that_jumps_although_its_polls_do_not_add_up(tmp_path: Path, timeout_s: float) -> None:
    body = (
        f"steps:\n- let: {{x: 0}}\n- wait_s: 0.1\n- {{wait_until: x > 1, timeout_s: {timeout_s}, on_failure: skip}}\n"
    )
    with rigs(tmp_path, clock=LockStepClock(), a={}) as fleet:
        report = run(fleet, tmp_path, body)

    assert [record.outcome for record in report.steps] == ["done", "skipped"]
    assert report.duration_s == pytest.approx(0.1 + timeout_s)


def test_a_time_limit_holds_for_a_spare_that_takes_over_inside_the_block(tmp_path: Path) -> None:
    body = """
        on_failure: substitute
        steps:
          - on: all
            do:
              - sequence:
                  - wait_s: 3
                  - send_cmd: {resource: Base, cmd: flaky}
                  - wait_s: 100
                timeout_s: 5
                on_failure: skip
              - log: on
        """
    body = body.replace("cmd: flaky}\n", "cmd: flaky}\n                    on_failure: substitute\n")
    head = HEAD.replace("all: {}", "all: {spares: 1}")
    with rigs(tmp_path, clock=LockStepClock(), a={"failures": 1}, b={}) as fleet:
        report = run(fleet, tmp_path, body, head)

    assert (report.outcome, outcomes(report)) == ("done", {"a": "replaced", "b": "done"})
    assert report.duration_s == pytest.approx(8), "it starts anew for the spare, and counts once"
    assert ("sequence", "skipped", 1) in brief(report, "b")
