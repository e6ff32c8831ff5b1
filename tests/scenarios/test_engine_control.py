"""Pauses, single steps, and runs resumed after their controller died."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import (
    LogLine,
    Run,
    RunEvent,
    RunPaused,
    RunResumed,
    StepEnded,
    make_plan,
    read_run,
)
from tests.scenarios.rig import HEAD, ask, rigs, scenario
from tests.scenarios.running import ON, WAIT_S, Watch, brief, records

NOW = "  - send_cmd: {resource: Base, cmd: now}\n"


class Gate:
    """A listener that lets a test wait for the n-th event of a kind."""

    def __init__(self, kind: type[RunEvent], count: int = 1) -> None:
        self.reached = threading.Event()
        self._kind = kind
        self._left = count

    def __call__(self, event: RunEvent) -> None:
        self._left -= isinstance(event, self._kind)
        if self._left == 0:
            self.reached.set()

    def wait(self) -> None:
        assert self.reached.wait(WAIT_S)


def test_a_paused_run_begins_nothing_and_its_timeouts_stand_still(two: Fleet, tmp_path: Path) -> None:
    body = f"""{ON}
    - send_cmd: {{resource: Base, cmd: go2}}
    - if: index == 0
      then: [{{wait_for: ready, timeout_s: 20}}]
      else: [{{send_cmd: {{resource: Base, cmd: go1}}}}, {{signal: ready}}]
"""
    watch, paused, ended = Watch(), Gate(RunPaused), Gate(StepEnded, 2)
    run = Run(make_plan(scenario(tmp_path, body), two), two, None, [watch, paused, ended])
    future = run.start()
    run.pause()
    paused.wait()
    ended.reached.wait(0.5)
    assert run.is_paused
    two.clock.sleep(60)
    run.resume()
    report = future.get()

    assert report.outcome == "done"
    assert report.paused_s >= 60
    kinds = [type(event) for event in watch.events if isinstance(event, RunPaused | RunResumed)]
    assert kinds == [RunPaused, RunResumed]


def test_a_wait_of_a_paused_run_takes_neither_time_nor_memory(tmp_path: Path) -> None:
    text = "steps:\n- {wait_for: x, timeout_s: 0.01, default: 1}\n- if: 1 == 2\n  then: [{signal: x}]\n"
    with rigs(tmp_path, clock=LockStepClock(), a={}) as fleet:
        paused = Run(
            make_plan(scenario(tmp_path, text), fleet), fleet, None, [Watch("wait_for x", lambda: paused.pause())]
        )
        future = paused.start()
        fleet.clock.sleep(1000)
        ((waiting, _),) = paused._run.signals._waiting[paused._run.main, "x"].items()
        assert len(waiting._callbacks or ()) < 5
        paused.resume()
        report = future.get()

    assert report.outcome == "done"
    assert report.duration_s - report.paused_s == pytest.approx(0.01, abs=1e-6)


def test_single_steps(tmp_path: Path) -> None:
    with rigs(tmp_path, a={}, b={}) as fleet:
        plan = make_plan(scenario(tmp_path, ON + NOW * 3), fleet)
        gates = [Gate(StepEnded, 2 * number) for number in (1, 2, 3)]
        paused = Gate(RunPaused)
        run = Run(plan, fleet, None, [paused, *gates])
        run.pause()
        future = run.start()
        paused.wait()
        for number, gate in enumerate(gates):
            assert not gate.reached.is_set()
            run.step()
            gate.wait()
            assert not any(later.reached.is_set() for later in gates[number + 1 :])
        run.resume()

        assert future.get().outcome == "done"


def test_a_paused_run_can_be_aborted(two: Fleet, tmp_path: Path) -> None:
    run = Run(make_plan(scenario(tmp_path, ON + NOW), two), two)
    run.pause()
    future = run.start()
    run.abort("enough")

    assert future.get(timeout=WAIT_S * 20).outcome == "aborted"
    run.pause()
    assert not run.is_paused, "it is over"


# Resuming after a crash.

STEPS = """\
timeout_s: 1000
safe_to_repeat: true
steps:
  - let: {total: 1}
  - on: all
    do:
      - let: {mine: index + 5}
      - send_cmd: {resource: Base, cmd: now}
      - signal: ready
  - on: all
    do:
      - send_cmd: {resource: Base, cmd: go8}
      - send_cmd: {resource: Base, cmd: go8}
  - on: all
    do:
      - wait_for: ready
        count: 2
        timeout_s: 1
      - log: "${mine} ${total}"
"""
CRASH = """\
import os
import sys
from pathlib import Path

from eal_actors.facade.fleet import Fleet
from eal_actors.scenario import StepEnded, run_scenario


def crash(event):
    if isinstance(event, StepEnded) and event.record.label == "send_cmd Base go8":
        os._exit(9)


folder = Path(sys.argv[1])
with Fleet.load(folder / "fleet.yaml") as fleet:
    run_scenario(folder / "trial.yaml", fleet, directory=folder / "run", listeners=[crash])
"""


def crash(folder: Path) -> Path:
    """Run the scenario in a process that dies in its third step; return the run's folder."""
    done = subprocess.run([sys.executable, "-c", CRASH, str(folder)], timeout=60, check=False)
    assert done.returncode == 9
    with (folder / "run/events.jsonl").open("a") as stream:
        stream.write('{"event": "step_st')  # half a line
    return folder / "run"


def test_a_run_goes_on_where_its_controller_died(tmp_path: Path) -> None:
    with rigs(tmp_path, head="clock: {rate: 50}", a={}, b={"slowness": 2}) as fleet:
        trial = scenario(tmp_path, STEPS)
        resumption = read_run(crash(tmp_path))
        watch = Watch()
        assert (resumption.first_step, resumption.was_begun) == (2, True)
        run = Run(make_plan(trial, fleet), fleet, resumption.directory, [watch], resumption)
        report = run.start().get()

    assert report.outcome == "done", report.error
    lines = sorted(event.text for event in watch.events if isinstance(event, LogLine))
    assert lines == ["5 1", "6 1"]
    assert [line[0] for line in brief(report, "b")] == [
        "send_cmd Base now",
        *["send_cmd Base go8"] * 3,  # the first was under way when the controller died
        "wait_for ready",
    ]
    assert [line[0] for line in brief(report, "a")].count("send_cmd Base go8") == 3, "one before, and two after"
    events = [json.loads(line) for line in (tmp_path / "run/events.jsonl").read_text().splitlines()]
    assert [event["event"] for event in events].count("run_continued") == 1
    times_s = [event["time_s"] for event in events]
    assert times_s == sorted(times_s)
    assert json.loads((tmp_path / "run/summary.json").read_text()) == report.model_dump(mode="json")
    with pytest.raises(ScenarioError, match="has ended"):
        read_run(tmp_path / "run")


def test_a_step_that_is_not_safe_is_not_repeated(tmp_path: Path) -> None:
    text = STEPS.replace("safe_to_repeat: true\n", "")
    text = text.replace("  - let: {total: 1}", "  - let: {total: 1}\n    safe_to_repeat: true")
    with rigs(tmp_path, head="clock: {rate: 50}", a={}, b={"slowness": 2}) as fleet:
        plan = make_plan(scenario(tmp_path, text), fleet)
        resumption = read_run(crash(tmp_path))
        with pytest.raises(ScenarioError) as caught:
            Run(plan, fleet, resumption.directory, [], resumption)
        with pytest.raises(ScenarioError, match="has changed since the run"):
            Run(make_plan(scenario(tmp_path, STEPS), fleet), fleet, resumption.directory, [], resumption)

    assert "send_cmd Base go8 (steps[2].do[0], " in caught.value.message
    assert "was under way, and is not safe to repeat, in steps[2] (" in caught.value.message


def test_what_is_no_run_that_was_cut_off(two: Fleet, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="has no record of a run: No such file"):
        read_run(tmp_path)
    (tmp_path / "events.jsonl").write_text("hello\n")
    with pytest.raises(ScenarioError, match=r"events.jsonl:1: is no event: Expecting value"):
        read_run(tmp_path)
    (tmp_path / "events.jsonl").write_text('{"event": "log", "time_s": 0, "robot": null, "text": ""}\n')
    with pytest.raises(ScenarioError, match="does not begin with the event run_started"):
        read_run(tmp_path)


def test_a_damaged_event_is_named_by_its_line(tmp_path: Path) -> None:
    with rigs(tmp_path, head="clock: {rate: 50}", a={}, b={"slowness": 2}):
        scenario(tmp_path, STEPS)
        events = crash(tmp_path) / "events.jsonl"
    lines = events.read_text().split("\n")
    number = next(number for number, line in enumerate(lines, 1) if '"checkpoint"' in line)
    lines[number - 1] = lines[number - 1].replace("next_step", "text_step")
    events.write_text("\n".join(lines))
    with pytest.raises(ScenarioError, match=f"events.jsonl:{number}: is no event: checkpoint: next_step: is missing"):
        read_run(tmp_path / "run")


def test_robots_that_left_stay_away(tmp_path: Path) -> None:
    text = STEPS.replace("cmd: now}", "cmd: flaky}")
    text = text.replace("safe_to_repeat: true", "safe_to_repeat: true\non_failure: drop").replace(
        "count: 2", "count: 1"
    )
    with rigs(tmp_path, head="clock: {rate: 50}", a={}, b={"failures": 1}) as fleet:
        trial = scenario(tmp_path, text, HEAD)
        resumption = read_run(crash(tmp_path))
        report = Run(make_plan(trial, fleet), fleet, resumption.directory, [], resumption).start().get()

    assert (report.outcome, report.robots["b"].outcome) == ("done", "dropped")
    assert len(records(report, "b")) == 1


def cut(folder: Path, kind: str, count: int) -> Path:
    """Let a record end after the n-th event of a kind, as if its controller had died then; return the run's folder."""
    lines = (folder / "run/events.jsonl").read_text().splitlines(keepends=True)
    places = [number for number, line in enumerate(lines) if json.loads(line)["event"] == kind]
    (folder / "run/events.jsonl").write_text("".join(lines[: places[count - 1] + 1]))
    (folder / "run/summary.json").unlink()
    return folder / "run"


def test_a_robot_that_was_twice_interrupted_in_a_common_start_keeps_nobody_waiting(tmp_path: Path) -> None:
    text = "steps:\n- on: all\n  do:\n" + "  - {set_value: {resource: Base, value: 1}, together: true}\n" * 2
    with rigs(tmp_path, clock=LockStepClock(), a={}, b={}) as fleet:
        plan = make_plan(scenario(tmp_path, text), fleet)
        assert Run(plan, fleet, tmp_path / "run").start().get().outcome == "done"
        for count in (2, 3):  # both have begun the first step, and one has ended it; then the other begins it again
            resumption = read_run(cut(tmp_path, "step_ended" if count == 2 else "step_started", count - (count == 2)))
            report = Run(plan, fleet, resumption.directory, [], resumption).start().get()
            assert report.outcome == "done", report.error


def test_the_end_of_a_part_that_was_over_is_not_repeated(tmp_path: Path) -> None:
    part = "steps:\n- log: x\nfinally:\n- on: all\n  do: [{send_cmd: {resource: Base, cmd: now}}]\n"
    (tmp_path / "part.yaml").write_text(HEAD + part)
    text = "steps:\n- sequence:\n  - scenario: part.yaml\n  - wait_s: 1\n"
    with rigs(tmp_path, clock=LockStepClock(), a={}, b={}) as fleet:
        plan = make_plan(scenario(tmp_path, text), fleet)
        assert Run(plan, fleet, tmp_path / "run").start().get().outcome == "done"
        resumption = read_run(cut(tmp_path, "step_started", 3))
        report = Run(plan, fleet, resumption.directory, [], resumption).start().get()

        assert report.outcome == "done", report.error
        assert [ask(fleet, robot, "tries") for robot in fleet] == [1, 1]


@pytest.mark.parametrize("is_safe", [True, False])
def test_a_robot_that_does_not_start_again_is_replaced_where_the_step_is_repeated(
    tmp_path: Path, *, is_safe: bool
) -> None:
    head = HEAD.replace("all: {}", "all: {spares: 1, on_failure: substitute}")
    text = "steps:\n- on: all\n  do: [{set_value: {resource: Base, value: 1}}, {log: '${robot}'}]\n"
    text += "  safe_to_repeat: true\n" if is_safe else ""
    with rigs(tmp_path, clock=LockStepClock(), a={}, b={}) as fleet:
        plan = make_plan(scenario(tmp_path, text, head), fleet)
        assert Run(plan, fleet, tmp_path / "run").start().get().outcome == "done"
    folder, watch = cut(tmp_path, "step_started", 1), Watch()
    with rigs(tmp_path, clock=LockStepClock(), a={"is_broken": True}, b={}) as fleet:
        plan, resumption = make_plan(scenario(tmp_path, text, head), fleet), read_run(folder)
        if is_safe:
            assert Run(plan, fleet, folder, [watch], resumption).start().get().outcome == "done"
        else:
            with pytest.raises(ScenarioError, match="a did not start, and no spare can go on inside steps"):
                Run(plan, fleet, folder, [watch], resumption)

    assert [event.text for event in watch.events if isinstance(event, LogLine)] == (["b"] if is_safe else [])
