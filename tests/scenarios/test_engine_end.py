from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import CallCancelledError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import (
    Report,
    Run,
    RunEnded,
    RunEvent,
    RunStarted,
    make_plan,
    run_scenario,
)
from tests.scenarios.rig import ask, rigs, scenario
from tests.scenarios.running import ON, WAIT_S, Watch, brief, outcomes, records, run


def finally_of(*commands: str) -> str:
    """Return a `finally` in which every robot sends these commands to its Base."""
    steps = "".join(f"  - send_cmd: {{resource: Base, cmd: {command}}}\n" for command in commands)
    return f"finally:\n- on: all\n  do:\n{steps}"


FINALLY = finally_of("fail", "s")


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
    fleet: Fleet,
    folder: Path,
    label: str,
    body: str,
    abort: Callable[[Run], object],
    times: int = 1,
    directory: Path | None = None,
) -> Report:
    """Run a scenario; abort it from this thread when a step with the label begins."""
    reached = threading.Event()
    aborted = Run(make_plan(scenario(folder, body), fleet), fleet, directory, [Watch(label, reached.set)])
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


SLOW_FINALLY = finally_of("go99", "now")


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

    def listener(event: RunEvent) -> None:
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
    broken._robots["fast"].pending = None  # type: ignore[assignment]
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

    def sabotage(event: RunEvent) -> None:
        if isinstance(event, RunStarted):
            (folder / "events.jsonl").unlink()
            folder.rmdir()

    report = run(two, tmp_path, f"{ON}  - log: x\n", directory=folder, listeners=[sabotage])

    assert report.outcome == "failed"
    assert report.error is not None
    assert f"its record in {folder} cannot be written" in report.error.message


def test_a_full_disk_at_an_event_of_no_step_halts_the_robots_and_runs_finally(two: Fleet, tmp_path: Path) -> None:
    def fill(run: Run) -> None:
        journal = run._journal
        journal.close()
        journal._stream = Path("/dev/full").open("w", buffering=1)  # noqa: SIM115  # the run closes it
        run.log(None, "a line that no disk takes")

    report = abort_at(two, tmp_path, "send_cmd Base go100", LONG + finally_of("s"), fill, directory=tmp_path / "run")

    assert report.outcome == "failed"
    assert report.error is not None
    assert "cannot be written: No space left on device" in report.error.message
    assert [ask(two, robot, "stops") for robot in two] == [1, 1]
    assert all(ask(two, robot, "halts") >= 1 for robot in two)
    assert report.duration_s < 90


def test_sigterm_runs_finally_and_ends_the_program(two: Fleet, tmp_path: Path) -> None:
    listener = Watch("send_cmd Base go100", lambda: os.kill(os.getpid(), signal.SIGTERM))
    with pytest.raises(SystemExit) as ended:
        run(two, tmp_path, LONG + finally_of("s"), listeners=[listener])

    assert ended.value.code == 128 + signal.SIGTERM
    assert [ask(two, robot, "stops") for robot in two] == [1, 1]


def test_a_cancelled_task_runs_finally_and_ends(two: Fleet, tmp_path: Path) -> None:
    trial = scenario(tmp_path, LONG + finally_of("s"))
    with two.tasks() as tasks:
        listener = Watch("send_cmd Base go100", tasks.cancel)
        task = tasks.start(run_scenario, trial, two, listeners=[listener])

    assert isinstance(task.exception(), CallCancelledError)
    assert [ask(two, robot, "stops") for robot in two] == [1, 1]
    assert two.clock.now() < 90


INTERRUPTED = """\
import sys
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("policy", ["abort", "drop", "skip", "{retry: 3, back_off_s: 0.1, then: skip}"])
def test_an_emergency_stop_aborts_whatever_the_policy(two: Fleet, tmp_path: Path, policy: str) -> None:
    body = f"on_failure: {policy}\n" + LONG + "  - send_cmd: {resource: Base, cmd: go1}\n" + finally_of("go1", "s")
    report = abort_at(two, tmp_path, "send_cmd Base go100", body, lambda _: two.stop("the red button").get())

    assert report.outcome == "aborted"
    assert report.error is not None
    assert "emergency stop: " in report.error.message
    assert report.error.message.count("the red button") == 1
    assert set(outcomes(report).values()) == {"aborted"}
    assert {record.outcome for record in report.steps} <= {"aborted", "done"}
    assert records(report, "fast")[-1].label == "send_cmd Base s"


def test_the_first_ends_an_on_in_finally_too(tmp_path: Path) -> None:
    body = f"{ON}  - log: x\nfinally:\n- on: all\n  until: first\n  do: [{{send_cmd: {{resource: Base, cmd: go9}}}}]\n"
    with rigs(tmp_path, clock=LockStepClock(), fast={"slowness": 0.1}, slow={}) as fleet:
        report = run(fleet, tmp_path, body)

    assert {record.robot: record.outcome for record in report.steps} == {"fast": "done", "slow": "stopped"}
    assert report.duration_s == pytest.approx(0.9)
