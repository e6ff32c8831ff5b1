"""A run is resumed after each of its events, and again after an event of the run that was resumed."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario import Plan, Report, Run, make_plan, read_run
from tests.scenarios.rig import HEAD, ask, rigs, scenario

PART = """\
steps:
- on: all
  do:
  - send_cmd: {resource: Base, cmd: now}
  - {barrier: inside, timeout_s: 50}
  - set_value: {resource: Base, value: 1}
finally:
- on: all
  do:
  - if: value('Base') == 1
    then: [{send_cmd: {resource: Base, cmd: now}}]
"""
BODY = """\
steps:
- sequence:
  - on: all
    do:
    - {set_value: {resource: Base, value: 1}, together: true}
    - let: {seen: value('Base')}
    - repeat: 2
      do: [{send_cmd: {resource: Base, cmd: now}}, {barrier: here, timeout_s: 100}]
    - parallel:
      - [{wait_s: 1}, {signal: waited}]
      - [{get_config: {resource: Base, key: gain}, save_as: gain}, {let: {seen: seen + gain}}]
    - {set_value: {resource: Base, value: 1}, together: true}
  - scenario: part.yaml
  - on: all
    do: [{scenario: part.yaml}, {send_cmd: {resource: Base, cmd: fail}, on_failure: skip}]
  - {wait_for: waited, count: 2, timeout_s: 1}
"""
COMMANDS = {"a": 7, "b": 7}
"""How often each robot is sent a command that must not be repeated."""


def events(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def commands_of(folder: Path) -> Counter[str]:
    """Return how often each robot has ended a command."""
    records = [event["record"] for event in events(folder) if event["event"] == "step_ended"]
    return Counter(record["robot"] for record in records if record["kind"] == "send_cmd")


def cut(folder: Path, count: int, into: Path) -> Path:
    """Copy the first events of a run, as if its controller had died after them."""
    into.mkdir()
    lines = (folder / "events.jsonl").read_text().splitlines(keepends=True)
    (into / "events.jsonl").write_text("".join(lines[:count]))
    return into


def resume(plan: Plan, fleet: Fleet, folder: Path) -> Report | None:
    """Resume a run; return None if it is refused because of a command that was under way."""
    before, made = {robot: ask(fleet, robot, "tries") for robot in fleet}, commands_of(folder)
    try:
        run = Run(plan, fleet, folder, [], read_run(folder))
    except ScenarioError as error:
        if "was under way, and is not safe to repeat" not in error.message:
            raise
        return None
    report = run.start()
    fleet.clock.sleep(1000)
    assert report.done(), f"{folder} stands still"
    assert report.get().outcome == "done", report.get().error
    left = {robot: ask(fleet, robot, "tries") - before[robot] for robot in fleet}
    assert left == {robot: COMMANDS[robot] - made[robot] for robot in fleet}, folder
    return report.get()


def test_a_run_continues_after_each_of_its_events_and_carries_out_no_command_twice(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(HEAD + PART)
    with rigs(tmp_path, clock=LockStepClock(), a={}, b={}) as fleet:
        plan = make_plan(scenario(tmp_path, BODY), fleet)
        whole = Run(plan, fleet, tmp_path / "whole").start().get()
        assert (whole.outcome, commands_of(tmp_path / "whole")) == ("done", COMMANDS)
        count = len(events(tmp_path / "whole"))
        outcomes: Counter[str] = Counter()
        for number in range(2, count):
            folder = cut(tmp_path / "whole", number, tmp_path / f"once-{number}")
            if (report := resume(plan, fleet, folder)) is None:
                outcomes["refused"] += 1
                continue
            assert report.robots["a"].variables == whole.robots["a"].variables
            middle = (number + len(events(folder))) // 2
            again = resume(plan, fleet, cut(folder, middle, tmp_path / f"twice-{number}"))
            outcomes["refused again" if again is None else "done"] += 1

    assert outcomes["done"] > count / 4, outcomes
