"""Python steps: their arguments, failures, timeouts and missing permissions."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import LogLine, make_plan
from tests.scenarios.rig import ask, rigs, scenario
from tests.scenarios.running import ON, WAIT_S, Watch, outcomes, run

MODULE = r"""def greet(context, name="you", times=1):
    context.log(f"hello {name}")
    return {"robot": context.robot, "seed": context.seed, "x": context.variables["x"] * times}


def keep(context):
    (context.directory / "note.txt").write_text(",".join(context.robots))


def drive(context, command):
    for robot in context.robots.values():
        robot["Base"].send_cmd(command).get()


def wander(context):
    context.clock.sleep(5)
    for robot in context.robots.values():
        robot["Base"].send_cmd("now").get()


def who(context):
    return ",".join(context.robots)


def fail(context):
    raise ValueError("no luck")


def wait_long(context):
    while not context.is_cancelled():
        context.clock.sleep(0.5)


class Odd:
    def __eq__(self, other):
        raise RuntimeError("not to be compared")

    def __repr__(self):
        raise RuntimeError("not to be shown")


def odd(context, is_long=False):
    return 10**6000 if is_long else Odd()


class Spiteful:
    def __getattr__(self, name):
        raise RuntimeError(f"no {name}")


def give(context, kind):
    if kind == "name":
        raise OSError("no file \udcff")
    endless = []
    endless.append(endless)
    return {"text": "half \ud800", "spiteful": Spiteful(), "endless": endless}[kind]


not_callable = 5
"""
STEPS = ("greet", "keep", "drive", "wander", "who", "fail", "wait_long", "odd", "give", "gone", "not_callable")
ALLOWED = f"python_steps: [{', '.join(f'helpers:{name}' for name in STEPS)}, nowhere:x]"


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    (tmp_path / "helpers.py").write_text(MODULE)
    with rigs(tmp_path, head=ALLOWED, a={}, b={}) as opened:
        yield opened


def test_a_step_is_given_its_robot_and_its_arguments(fleet: Fleet, tmp_path: Path) -> None:
    watch = Watch()
    body = f"""{ON}
    - let: {{x: index + 2}}
    - python: helpers:greet
      with: {{name: "${{robot}}", times: 10}}
      save_as: answer
    - log: "${{answer['x']}} ${{answer['robot']}}"
- python: helpers:keep
"""
    report = run(fleet, tmp_path, body, listeners=[watch], directory=tmp_path / "run")

    lines = [(event.robot, event.text) for event in watch.events if isinstance(event, LogLine)]
    assert report.outcome == "done", report.error
    assert sorted(lines, key=str) == sorted([("a", "hello a"), ("b", "hello b"), ("a", "20 a"), ("b", "30 b")], key=str)
    assert (tmp_path / "run/note.txt").read_text() == "a,b"
    assert [record.label for record in report.steps if record.robot is None] == ["python helpers:keep"]


def test_a_step_may_use_robots(fleet: Fleet, tmp_path: Path) -> None:
    report = run(fleet, tmp_path, "steps: [{python: 'helpers:drive', with: {command: now}}]")

    assert report.outcome == "done"
    assert [robot["Base"].send_req("tries").get().value for robot in fleet.values()] == [1, 1]


def test_a_step_that_raises_fails_as_any_other(fleet: Fleet, tmp_path: Path) -> None:
    report = run(fleet, tmp_path, f"{ON}  - python: helpers:fail\n    on_failure: {{retry: 1, then: skip}}\n")

    assert report.outcome == "done"
    record = report.steps[0]
    assert (record.outcome, record.attempts) == ("skipped", 2)
    assert record.error is not None
    assert record.error.message == "Python step 'helpers:fail' raised ValueError: no luck"


def test_a_step_has_a_deadline_and_is_told(fleet: Fleet, tmp_path: Path) -> None:
    report = run(fleet, tmp_path, "steps: [{python: 'helpers:wait_long', timeout_s: 2}]")

    assert (report.outcome, outcomes(report)) == ("failed", {"a": "aborted", "b": "aborted"})
    assert report.error is not None
    assert (report.error.code, report.error.message) == (
        "deadline",
        "Python step 'helpers:wait_long' had no answer before its deadline",
    )
    assert not [thread for thread in threading.enumerate() if "python step" in thread.name]


def test_an_abort_cancels_a_step(fleet: Fleet, tmp_path: Path) -> None:
    body = "steps: [{parallel: [[{python: 'helpers:wait_long', timeout_s: 1000}], [{wait_s: 1}, {expect: 1 == 2}]]}]"
    report = run(fleet, tmp_path, body)

    assert report.duration_s < WAIT_S * 20
    assert [record.outcome for record in report.steps if record.kind == "python"] == ["aborted"]


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("helpers:secret", "is not among the python_steps that fleet 'rigs' allows; add it there"),
        ("helpers:gone", "cannot be loaded: AttributeError"),
        ("helpers:not_callable", "is no function"),
        ("nowhere:x", "cannot be loaded: ModuleNotFoundError"),
        ("stitch", "unknown Python step 'stitch'"),
        ("helpers:drive", "does not take these arguments: missing a required argument: 'command'"),
    ],
)
def test_what_cannot_be_run_is_found_before_anything_moves(
    fleet: Fleet, tmp_path: Path, step: str, message: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        make_plan(scenario(tmp_path, f"steps: [{{python: '{step}'}}]"), fleet)

    assert "trial.yaml:6:18: steps[0].python: " in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize("is_long", ["true", "false"])
def test_whatever_a_step_returns_fails_only_the_steps_that_cannot_use_it(
    fleet: Fleet, tmp_path: Path, is_long: str
) -> None:
    body = f"""
        on_failure: skip
        steps:
          - {{python: 'helpers:odd', with: {{is_long: {is_long}}}, save_as: odd}}
          - log: "${{odd}}"
          - expect: odd == 3
          - {{expect: odd, equals: 3.5, tolerance: 1}}
          - wait_s: "${{odd}}"
          - {{wait_for: told, count: "${{odd}}", timeout_s: 1}}
          - repeat: "${{odd}}"
            do: [{{log: never}}]
          - for: {{x: "${{odd}}"}}
            do: [{{log: never}}]
          - {{signal: told, value: "${{odd}}"}}
        """
    report = run(fleet, tmp_path, body)

    failed = [record.step for record in report.steps if record.outcome == "skipped"]
    assert report.outcome == "done", report.error
    assert failed == [*(f"steps[{number}]" for number in range(1, 6)), "steps[6].repeat", "steps[7].for.x"]


@pytest.mark.parametrize("kind", ["text", "spiteful", "endless"])
def test_a_result_that_no_variable_can_hold_fails_its_step(fleet: Fleet, tmp_path: Path, kind: str) -> None:
    body = f"on_failure: skip\nsteps: [{{python: 'helpers:give', with: {{kind: {kind}}}, save_as: x}}]\n"
    report = run(fleet, tmp_path, body, directory=tmp_path / "run")

    assert report.outcome == "done", report.error
    (record,) = report.steps
    assert record.error is not None
    assert "Python step 'helpers:give' returned what no variable can hold: " in record.error.message


def test_an_error_with_half_a_character_is_recorded_with_its_escape(fleet: Fleet, tmp_path: Path) -> None:
    body = "on_failure: skip\nsteps: [{python: 'helpers:give', with: {kind: name}}]\n"
    report = run(fleet, tmp_path, body, directory=tmp_path / "run")

    assert report.outcome == "done", report.error
    (record,) = report.steps
    assert record.error is not None
    assert record.error.message.endswith("no file \\udcff")


def test_a_step_in_finally_may_use_every_robot_that_took_part(fleet: Fleet, tmp_path: Path) -> None:
    report = run(fleet, tmp_path, "steps: [{log: x}]\nfinally: [{python: 'helpers:who', save_as: names}]\n")

    assert report.variables == {"names": "a,b"}


def test_a_function_of_a_run_that_is_over_moves_nothing(tmp_path: Path) -> None:
    (tmp_path / "helpers.py").write_text(MODULE)
    body = "steps: [{parallel: [[{python: 'helpers:wander'}], [{wait_s: 1}, {expect: 1 == 2}]]}]"
    with rigs(tmp_path, clock=LockStepClock(), head=ALLOWED, a={}, b={}) as fleet:
        report = run(fleet, tmp_path, body)
        fleet.clock.sleep(10)
        tries = [ask(fleet, robot, "tries") for robot in fleet]

    assert report.outcome == "failed"
    assert report.duration_s == pytest.approx(1)
    assert tries == [0, 0]


def test_a_module_beside_the_fleet_file_has_one_state_and_may_have_dataclasses(tmp_path: Path) -> None:
    (tmp_path / "surveying.py").write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\n\n@dataclass\nclass Count:\n"
        "    value: int = 0\n\ncount = Count()\n\ndef one(context):\n    count.value += 1\n\n"
        "def two(context):\n    return count.value\n"
    )
    with rigs(tmp_path, head="python_steps: [surveying:one, surveying:two]", a={}) as fleet:
        steps = "steps: [{python: 'surveying:one'}, {python: 'surveying:two', save_as: total}]"
        assert run(fleet, tmp_path, steps).variables == {"total": 1}
