"""The scenario step `fit_umbmark`."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eal_actors.device.differential_base import WheelCalibration
from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.calibration.square import WAYS, along_arc, square_end
from eal_actors.lab.calibration.step import fit_umbmark
from eal_actors.scenario.steps.python import StepContext
from eal_actors.testing import Simulation
from tests.unit.lab.contexts import step_context

TRUTH = WheelCalibration(track_factor=1.012, wheel_ratio=1.004)
START = [0.3, -0.2, 1.0]


@pytest.fixture
def context(tmp_path: Path) -> Iterator[StepContext]:
    with Simulation({"rob": "roomba"}) as simulation:
        yield step_context(tmp_path, robots=simulation.fleet, robot="rob")


def ends() -> list[list[Any]]:
    """Return ends without noise, of squares that began at START, as they are seen in the room."""
    found: list[list[Any]] = []
    for way in WAYS:
        x_m, y_m, yaw_rad = square_end(way, 1.0, 0.258, TRUTH)
        ahead = along_arc((START[0], START[1], START[2]), x_m, 0.0)
        aside = along_arc((ahead[0], ahead[1], START[2] + math.pi / 2), y_m, 0.0)
        found.append([way, [aside[0], aside[1], yaw_rad + START[2]], [0.0, 0.0, 0.0]])
    return found


def test_what_made_the_ends_is_found_and_kept(context: StepContext, tmp_path: Path) -> None:
    logged: list[str] = []
    context = replace(context, log=logged.append)
    found = fit_umbmark(context, side_m=1.0, ends=ends(), start=START, name="first")
    assert (found["track_factor"], found["wheel_ratio"]) == pytest.approx((1.012, 1.004), abs=1e-7)
    farthest_m = max(math.hypot(*square_end(way, 1.0, 0.258, TRUTH)[:2]) for way in WAYS)
    assert found["error_m"] == pytest.approx(farthest_m)
    assert json.loads((tmp_path / "rob" / "first.json").read_text(encoding="utf-8")) == found
    assert logged == [f"off by {farthest_m * 1000:.0f} mm: E_b 1.0120, E_d 1.0040, 0 mm remain"]
    again = fit_umbmark(context, side_m=1.0, file=str(tmp_path / "rob" / "first.csv"))
    assert again["track_factor"] == pytest.approx(1.012, abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({}, "needs either `ends` or `file`"),
        ({"ends": [], "file": "x.csv"}, "needs either `ends` or `file`"),
        ({"ends": []}, "no square cw was measured"),
        ({"ends": [["left", [0, 0, 0]]]}, r"end 1 must be \[cw or ccw, .* not \['left'"),
        ({"ends": [["cw", "nowhere"]]}, "end 1 must be"),
    ],
)
def test_what_a_scenario_gives_wrongly_is_told(context: StepContext, arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        fit_umbmark(context, side_m=1.0, **arguments)


def test_outside_of_an_on_it_is_of_no_robot(context: StepContext) -> None:
    with pytest.raises(ScenarioError, match="inside an `on`"):
        fit_umbmark(replace(context, robot=None), side_m=1.0, ends=ends())
