"""`Fleet.each` and task groups: results, failures, cancellation, deadlines, lock step."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import pytest

from eal_actors import Fleet, RobotHandle, as_completed
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import (
    ArgumentError,
    CallCancelledError,
    DeadlineError,
    PreemptedError,
    RobotNotFoundError,
    WaitTimeoutError,
)
from eal_actors.testing import Simulation
from tests.patience import patient_fleet

ROBOTS = {name: {"model": "roomba", "start": (0.0, y_m)} for name, y_m in (("a", -1.0), ("b", 0.0), ("c", 1.0))}
WORLD = {"version": 1, "name": "hall", "size_m": [20, 8]}


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    with Simulation(ROBOTS, WORLD) as simulation:
        yield simulation


def drive(robot: RobotHandle) -> str:
    robot["Base"].send_cmd("f0.5").get()
    return robot.name


def assert_all_stand(simulation: Simulation) -> None:
    before = {name: simulation.pose(name) for name in ROBOTS}
    simulation.advance(3.0)
    assert {name: simulation.pose(name) for name in ROBOTS} == before


def task_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith(("drive", "watch", "work"))]


def test_each_returns_the_results_in_the_order_given_and_drives_at_the_same_time(simulation: Simulation) -> None:
    before_s = simulation.now_s
    results = simulation.fleet.each([simulation["c"], "a", simulation["b"]], drive)
    assert list(results.items()) == [("c", "c"), ("a", "a"), ("b", "b")]
    assert simulation.now_s - before_s < 2 * 0.5 / 0.2
    assert all(simulation.pose(name).x_m == pytest.approx(0.5, abs=0.05) for name in ROBOTS)


def test_each_takes_a_whole_fleet_and_no_robot_twice(simulation: Simulation) -> None:
    assert list(simulation.fleet.each(simulation.fleet, lambda robot: robot.name)) == list(ROBOTS)
    assert simulation.fleet.each([], drive) == {}
    with pytest.raises(ArgumentError, match="given twice"):
        simulation.fleet.each(["a", simulation["a"]], drive)
    with pytest.raises(RobotNotFoundError):
        simulation.fleet.each(["nobody"], drive)


def test_an_async_function_is_refused_instead_of_forgotten(simulation: Simulation) -> None:
    async def drive_later(robot: RobotHandle) -> None:
        await robot["Base"].send_cmd("f1")

    with pytest.raises(TypeError, match="drive_later a is an async function; a task is a function that blocks"):
        simulation.fleet.each(["a"], drive_later)


def test_a_failure_interrupts_the_others_and_halts_their_robots(simulation: Simulation) -> None:
    raised: dict[str, BaseException] = {}

    def work(robot: RobotHandle) -> None:
        if robot.name == "b":
            simulation.fleet.clock.sleep(1.0)
            raise ValueError("no more")
        try:
            robot["Base"].send_cmd("f5").get()
        except CallCancelledError as error:
            raised[robot.name] = error
            robot["Base"].send_cmd("f5")  # a command that nobody waits for does not outlive the group either
            raise

    with pytest.raises(ValueError, match="no more") as failure:
        simulation.fleet.each(simulation.fleet, work)
    assert failure.value.__notes__ == ["raised by task work b"]
    assert sorted(raised) == ["a", "c"]
    assert simulation.now_s == pytest.approx(1.0, abs=0.2)
    assert_all_stand(simulation)
    assert task_threads() == []


WAITS: dict[str, Callable[[Fleet, RobotHandle], object]] = {
    "sleep": lambda fleet, robot: fleet.clock.sleep(100.0),
    "get": lambda fleet, robot: robot["Base"].send_cmd("f5").get(),
    "exception": lambda fleet, robot: robot["Base"].send_cmd("f5").exception(),
    "as_completed": lambda fleet, robot: next(as_completed([robot["Base"].send_cmd("f5")])),
    "stream": lambda fleet, robot: list(islice(robot["TruePose"].stream(rate_hz=0.01), 2)),
    "each": lambda fleet, robot: fleet.each([robot, "c"], lambda robot: robot["Base"].send_cmd("f5").get()),
}


@pytest.mark.parametrize("wait", WAITS.values(), ids=WAITS)
def test_each_wait_of_a_cancelled_task_is_interrupted_and_so_are_later_ones(
    simulation: Simulation, wait: Callable[[Fleet, RobotHandle], object]
) -> None:
    def work(robot: RobotHandle) -> None:
        if robot.name == "b":
            simulation.fleet.clock.sleep(0.5)
            raise ValueError("over")
        with pytest.raises(CallCancelledError):
            wait(simulation.fleet, robot)
        with pytest.raises(CallCancelledError):
            simulation.fleet.clock.sleep(100.0)

    with pytest.raises(ValueError, match="over") as failure:
        simulation.fleet.each(["a", "b"], work)
    assert failure.value.__notes__ == ["raised by task work b"]
    assert simulation.now_s == pytest.approx(0.5, abs=0.2)
    assert_all_stand(simulation)


def test_a_cancelled_wait_cancels_its_call(simulation: Simulation) -> None:
    calls = []

    def work(robot: RobotHandle) -> None:
        if robot.name == "b":
            simulation.fleet.clock.sleep(0.5)
            raise ValueError("over")
        calls.append(simulation["c"]["Base"].send_cmd("f5"))  # of a robot that was not given to `each`
        calls[0].get()

    with pytest.raises(ValueError, match="over"):
        simulation.fleet.each(["a", "b"], work)
    assert calls[0].cancelled()
    assert_all_stand(simulation)


def test_errors_of_others_are_notes_of_the_first(simulation: Simulation) -> None:
    def work(robot: RobotHandle) -> None:
        try:
            simulation.fleet.clock.sleep(1.0 if robot.name == "b" else 9.0)
        except CallCancelledError:
            raise KeyError(robot.name) from None
        raise ValueError("first")

    with pytest.raises(ValueError, match="first") as failure:
        simulation.fleet.each(simulation.fleet, work)
    assert failure.value.__notes__ == [
        "raised by task work b",
        "raised by task work a too: KeyError: 'a'",
        "raised by task work c too: KeyError: 'c'",
    ]


def test_a_failed_call_ends_each_with_its_own_error(simulation: Simulation) -> None:
    def work(robot: RobotHandle) -> None:
        robot["Base"].send_cmd("x9" if robot.name == "b" else "f5").get()

    with pytest.raises(ArgumentError) as failure:
        simulation.fleet.each(simulation.fleet, work)
    assert failure.value.robot == "b"
    assert_all_stand(simulation)


def test_a_preemption_by_somebody_else_is_a_failure(simulation: Simulation) -> None:
    with pytest.raises(PreemptedError), simulation.fleet.tasks() as tasks:  # noqa: PT012
        tasks.start(drive, simulation["a"])
        simulation.advance(0.5)
        simulation["a"]["Base"].send_cmd("s").get()


def test_the_deadline_of_each_names_the_tasks_and_halts_the_robots(simulation: Simulation) -> None:
    def work(robot: RobotHandle) -> None:
        if robot.name != "a":
            robot["Base"].send_cmd("f5").get()

    with pytest.raises(DeadlineError, match=r"did not end within 2 s: work b, work c"):
        simulation.fleet.each(simulation.fleet, work, timeout_s=2)
    assert simulation.now_s == pytest.approx(2.0, abs=0.2)
    assert_all_stand(simulation)
    assert task_threads() == []


def run_twice_the_same(fail: bool) -> tuple[list[tuple[float, ...]], list[str], float]:
    order: list[str] = []
    with Simulation(ROBOTS, WORLD, seed=4) as simulation:
        clock = simulation.fleet.clock

        def work(robot: RobotHandle) -> None:
            for command in ("f0.3", "r70", "f0.2", "l30"):
                robot["Base"].send_cmd(command).get()
                order.append(f"{robot.name} {command} {clock.now():.6f} {robot['TruePose'].get_value().get().value}")
                if fail and robot.name == "b" and command == "f0.2":
                    raise ValueError("over")

        for _ in range(2):
            try:
                simulation.fleet.each(simulation.fleet, work)
            except ValueError:
                order.append("failed")
        return [tuple(simulation.pose(name)) for name in ROBOTS], order, clock.now()


@pytest.mark.parametrize("fail", [False, True])
def test_in_lock_step_every_run_is_the_same(fail: bool) -> None:
    first = run_twice_the_same(fail)
    assert all(run_twice_the_same(fail) == first for _ in range(3))
    assert len(first[1]) == (24 if not fail else len(first[1]))


def test_a_group_runs_different_functions_and_cancel_ends_it_quietly(simulation: Simulation) -> None:
    clock, seen = simulation.fleet.clock, []

    def watch(robot: RobotHandle, period_s: float) -> None:
        while True:
            seen.append(robot["TruePose"].get_value().get().value[0])
            clock.sleep(period_s)

    with simulation.fleet.tasks() as tasks:
        tasks.start(watch, simulation["a"], period_s=0.5)
        assert tasks.start(drive, simulation["a"]).get() == "a"
        tasks.cancel()
        with pytest.raises(CallCancelledError):
            clock.sleep(1.0)  # the block belongs to the group
        clock.sleep(1.0)
    assert len(seen) > 3
    assert task_threads() == []
    with pytest.raises(RuntimeError, match="inside the `with` block"):
        tasks.start(drive, simulation["a"])


def test_a_failing_task_interrupts_the_block(simulation: Simulation) -> None:
    def fail() -> None:
        simulation.fleet.clock.sleep(1.0)
        raise ValueError("over")

    with pytest.raises(ValueError, match="over"), simulation.fleet.tasks() as tasks:  # noqa: PT012
        tasks.start(fail)
        simulation["a"]["Base"].send_cmd("f5").get()
    assert simulation.now_s == pytest.approx(1.0, abs=0.2)


def test_an_error_of_the_block_ends_the_tasks(simulation: Simulation) -> None:
    with pytest.raises(WaitTimeoutError), simulation.fleet.tasks() as tasks:
        tasks.start(drive, simulation["a"]).get(timeout=0.5)
    assert simulation.pose("a").x_m < 0.3
    assert_all_stand(simulation)


def test_cancelling_one_task_ends_it_alone(simulation: Simulation) -> None:
    with simulation.fleet.tasks() as tasks:
        moving = {name: tasks.start(drive, simulation[name]) for name in ROBOTS}
        simulation.fleet.clock.sleep(0.5)
        moving["b"].cancel()
    assert {name: task.cancelled() for name, task in moving.items()} == {"a": False, "b": True, "c": False}
    assert simulation.pose("b").x_m < 0.3 < simulation.pose("a").x_m


def test_groups_nest_and_the_outer_one_cancels_the_inner(simulation: Simulation) -> None:
    fleet, ended = simulation.fleet, []

    def inner(robot: RobotHandle) -> None:
        try:
            robot["Base"].send_cmd("f5").get()
        finally:
            ended.append(robot.name)

    def outer() -> None:
        fleet.each(["a", "b"], inner)

    with pytest.raises(ValueError, match="over"), fleet.tasks() as tasks:  # noqa: PT012
        tasks.start(outer)
        fleet.clock.sleep(0.5)
        raise ValueError("over")
    assert sorted(ended) == ["a", "b"]
    assert_all_stand(simulation)


def test_each_works_on_a_clock_that_runs() -> None:
    with patient_fleet(bundled_path("fleets/sim.yaml"), rate=40) as fleet:
        robots = fleet.select(tags=["wheeled"])
        assert fleet.each(robots, lambda robot: robot["Base"].send_cmd("r20").get()) == {r.name: 1 for r in robots}
        with pytest.raises(DeadlineError):
            fleet.each(robots, lambda robot: robot["Base"].send_cmd("r3600").get(), timeout_s=1)
        assert all(robot["Base"].get_status().get() == 0 for robot in robots)


TURNING = """
import os, signal, sys, threading
from eal_actors import Fleet

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it for programs in the background

def turn(robot):
    os.write(1, b"turning\\n")  # one call a line: print's two would mix with another thread's
    while True:
        robot["Base"].send_cmd("r360").get()

with Fleet.load(sys.argv[1]) as fleet:
    try:
        fleet.each(fleet, turn)
    except KeyboardInterrupt:
        assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("turn")]
        assert not any(robot["Base"].get_status().get() for robot in fleet.values())
        print("all stand", flush=True)
        raise
"""


@pytest.mark.parametrize("rate", ["1", "max"])
def test_ctrl_c_halts_every_robot_and_leaves_no_thread(rate: str, tmp_path: Path) -> None:
    fleet, sim = tmp_path / "fleet.yaml", bundled_path("fleets/sim.yaml")
    fleet.write_text(f"version: 1\ninclude: ['{sim}']\nclock: {{rate: {rate}}}\ndefaults: {{timeout_s: 1000}}\n")
    with subprocess.Popen([sys.executable, "-c", TURNING, str(fleet)], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        try:
            assert [program.stdout.readline() for _ in range(3)] == ["turning\n"] * 3
            program.send_signal(signal.SIGINT)
            assert program.stdout.readline() == "all stand\n"
        except BaseException:
            program.kill()
            raise
    assert program.returncode == -signal.SIGINT


def test_each_is_for_connected_robots() -> None:
    fleet = Fleet.load(bundled_path("fleets/sim.yaml"))
    with pytest.raises(RobotNotFoundError, match="not connected"):
        fleet.each(["roomba-1"], drive)
