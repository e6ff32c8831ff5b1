"""The step `compare_views`: what it saves and refuses, and where scenarios find it."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import cv2
import numpy as np
import pytest

from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.changes.step import compare_views
from tests.unit.lab.contexts import step_context


def test_scenarios_find_the_step() -> None:
    (point,) = entry_points(group="eal_actors.steps", name="compare_views")
    assert point.load() is compare_views


def picture(folder: Path, name: str, has_thing: bool) -> None:
    image = np.full((240, 320, 3), 120, np.uint8)
    if has_thing:
        cv2.rectangle(image, (120, 100), (180, 150), (0, 0, 255), -1)
    (folder / "eye").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "eye" / name), image)


def test_what_has_changed_is_saved_and_what_has_not_is_not(tmp_path: Path) -> None:
    for name, has_thing in (("0.png", False), ("1.png", False), ("2.png", True)):
        picture(tmp_path, name, has_thing)
    logged: list[str] = []
    context = step_context(tmp_path, robot="eye", log=logged.append)
    same = compare_views(context, before="0.png", after="1.png", save="changed.1.png")
    other = compare_views(context, before="1.png", after="2.png", save="changed.2.png")
    assert same == {"things": 0, "share": 0.0}
    assert other["things"] == 1
    assert logged == ["2.png is not as 1.png: see changed.2.png"]
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


def test_the_picture_before_is_the_last_one_with_a_smaller_number(tmp_path: Path) -> None:
    for number, has_thing in ((1, True), (9, False), (10, True), (12, False)):
        picture(tmp_path, f"{number}.door.png", has_thing)
    picture(tmp_path, "changed.9.door.png", has_thing=True)
    logged: list[str] = []
    context = step_context(tmp_path, robot="eye", log=logged.append)
    for number, things in ((1, 0), (9, 1), (10, 1)):
        found = compare_views(context, before="*.door.png", after=f"{number}.door.png", save=f"seen.{number}.png")
        assert found["things"] == things
    assert logged == [
        "9.door.png is not as 1.door.png: see seen.9.png",
        "10.door.png is not as 9.door.png: see seen.10.png",
    ]
    for after in ("last.door.png", "10.gate.png"):
        with pytest.raises(ScenarioError, match=r"must be \*\.door\.png with a number"):
            compare_views(context, before="*.door.png", after=after, save="changed.png")
