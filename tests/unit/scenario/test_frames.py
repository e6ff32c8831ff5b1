from __future__ import annotations

from pathlib import Path

from eal_actors.scenario import load_scenario
from eal_actors.scenario.engine.frames import ExecutionContext, Frame, StepTask


def test_steps_of_a_part_outside_of_its_on_have_the_policy_of_its_file_for_lost_robots(tmp_path: Path) -> None:
    file = tmp_path / "part.yaml"
    file.write_text("version: 1\nname: part\nroles: {movers: {on_lost: fail}}\non_lost: drop\nsteps: [{wait_s: 1}]\n")
    frame = Frame(load_scenario(file), {}, {})

    assert ExecutionContext(StepTask(), frame, role="scouts").on_lost == "drop"
    assert ExecutionContext(StepTask(), frame, role="movers").on_lost == "fail"
