"""The steps that scenarios call by name: what they refuse, and where they are found."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.choreography.step import clearance_m, plan_formation
from eal_actors.lab.choreography.views import compare_views
from eal_actors.testing import Simulation
from tests.unit.lab.contexts import step_context


@pytest.mark.parametrize("name", ["plan_formation", "compare_views"])
def test_scenarios_find_the_step(name: str) -> None:
    (point,) = entry_points(group="eal_actors.steps", name=name)
    assert point.load().__name__ == name


def test_a_formation_is_planned_from_where_the_robots_stand() -> None:
    robots = {"a": {"model": "roomba", "start": (2, 0, 0)}, "b": {"model": "roomba", "start": (-2, 0, 0)}}
    logged: list[str] = []
    with Simulation(robots) as simulation:
        context = step_context(robots=simulation.fleet, log=logged.append)
        plan = plan_formation(context, shape="line", spacing_m=1.0, yaw_deg=90)
    assert plan["places"] == {"a": [0.5, 0.0, 90.0], "b": [-0.5, 0.0, 90.0]}
    assert plan["phases"] == [{"a": [0.5, 0.0], "b": [-0.5, 0.0]}]
    assert logged == ["2 robots form a line in 1 phase"]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"shape": "heart"}, "invalid formation: shape: Input should be 'line'"),
        ({"spacing_m": 0.0}, "invalid formation: spacing_m"),
        ({"spacing_m": 0.5}, "the robots cannot form this line: two places are 0.50 m apart"),
    ],
)
def test_what_no_formation_can_be_is_refused(wrong: dict[str, Any], message: str) -> None:
    with Simulation({"a": "roomba", "b": "roomba"}) as simulation, pytest.raises(ScenarioError, match=message):
        plan_formation(step_context(robots=simulation.fleet), **{"shape": "line", "spacing_m": 1.0, **wrong})


def test_the_margin_is_left_if_both_robots_stray() -> None:
    assert clearance_m(0.2, 0.1) == pytest.approx(0.2 + 0.05 + 0.1 + 0.05 + 0.2)


def picture(folder: Path, name: str, has_thing: bool) -> None:
    image = np.full((240, 320, 3), 120, np.uint8)
    if has_thing:
        cv2.rectangle(image, (120, 100), (180, 150), (0, 0, 255), -1)
    (folder / "eye").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "eye" / name), image)


def test_what_has_changed_is_saved_and_what_has_not_is_not(tmp_path: Path) -> None:
    for name, has_thing in (("0.png", False), ("1.png", False), ("2.png", True)):
        picture(tmp_path, name, has_thing)
    context = step_context(tmp_path, robot="eye")
    same = compare_views(context, before="0.png", after="1.png", save="changed.1.png")
    other = compare_views(context, before="1.png", after="2.png", save="changed.2.png")
    assert same == {"things": 0, "share": 0.0}
    assert other["things"] == 1
    assert 0.02 < other["share"] < 0.1
    assert not (tmp_path / "eye/changed.1.png").exists()
    both = cv2.imread(str(tmp_path / "eye/changed.2.png"))
    assert both is not None
    assert both.shape == (240, 640, 3)


def test_pictures_that_cannot_be_compared(tmp_path: Path) -> None:
    picture(tmp_path, "0.png", has_thing=False)
    cv2.imwrite(str(tmp_path / "eye/small.png"), np.zeros((100, 100, 3), np.uint8))
    (tmp_path / "eye/broken.png").write_text("no picture")
    context = step_context(tmp_path, robot="eye")
    for after, message in (
        ("1.png", "1.png is missing"),
        ("broken.png", "broken.png is not a picture"),
        ("small.png", "must have one shape"),
    ):
        with pytest.raises(ScenarioError, match=message):
            compare_views(context, before="0.png", after=after, save="changed.png")
    with pytest.raises(ScenarioError, match="put it inside an `on`"):
        compare_views(step_context(tmp_path), before="0.png", after="0.png", save="changed.png")
    with pytest.raises(ScenarioError, match="keeps no files"):
        compare_views(step_context(robot="eye"), before="0.png", after="0.png", save="changed.png")
