from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Circle, Rectangle

from eal_actors.device.world import WorldModel, load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.recording import PoseSample, draw_trajectory, draw_world
from eal_actors.recording.arena import draw_arena

WORLD = WorldModel.model_validate(
    {
        "version": 1,
        "name": "hall",
        "size_m": [6, 4],
        "textures": {"chart": {"pattern": "poster"}},
        "posters": [{"wall": "west", "at_m": 1, "texture": "chart"}],
        "obstacles": [
            {"kind": "box", "x_m": 1, "y_m": 1, "size_m": [1, 0.5], "yaw_deg": 30},
            {"kind": "circle", "x_m": -1, "y_m": 1, "radius_m": 0.25},
            {"kind": "wall", "start_m": [0, -2], "end_m": [0, -1]},
        ],
        "boxes": [{"name": "crate", "x_m": 2, "y_m": 0}],
        "beacons": [{"name": "dock", "x_m": 2.5, "y_m": 1.5, "colour": [0, 51, 255]}],
        "drops": [{"x_m": 2, "y_m": -1, "size_m": [0.5, 0.5]}],
        "starts": {"shape": "line", "count": 2, "spacing_m": 1, "x_m": -2, "yaw_deg": 90},
    }
)


def test_everything_stands_where_the_world_says() -> None:
    axes = Figure().subplots()
    draw_arena(axes, WORLD)

    rectangles = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    placed = [(*patch.get_center(), patch.get_width(), patch.get_height(), patch.get_angle()) for patch in rectangles]
    assert [pytest.approx(place) for place in placed] == [
        (0, 0, 6, 4, 0),
        (2, -1, 0.5, 0.5, 0),
        (1, 1, 1, 0.5, 30),
        (0, -1.5, 1, 0.1, 90),
        (2, 0, 0.3, 0.3, 0),
    ]
    assert [patch.get_hatch() is not None for patch in rectangles] == [False, True, False, False, False]
    (pillar,) = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert (*pillar.center, pillar.radius) == (-1, 1, 0.25)
    poster, starts, *strokes, beacon = [np.asarray(line.get_xydata()).tolist() for line in axes.lines]
    assert poster == [[-3, 0.5], [-3, 1.5]]
    assert starts == [[-2.5, 0], [-1.5, 0]]
    assert [pytest.approx(ends) for ends in np.ravel(strokes).reshape(2, 4).tolist()] == [
        (-2.5, 0, -2.5, 0.18),
        (-1.5, 0, -1.5, 0.18),
    ]
    assert beacon == [[2.5, 1.5]]
    assert to_rgb(axes.lines[-1].get_color()) == (0, 0.2, 1)


@pytest.mark.parametrize("name", ["empty", "field", "lab", "maze"])
def test_the_shipped_worlds_can_be_drawn(tmp_path: Path, name: str) -> None:
    world = load_world(bundled_path(f"fleets/worlds/{name}.yaml"))
    out = tmp_path / f"{name}.png"

    assert draw_world(world, out) == out
    height, width, _ = imread(out).shape
    ratio = world.size_m[1] / world.size_m[0]
    assert 0.7 * ratio < height / width < 1.2 * ratio


def test_a_path_is_drawn_in_its_arena(tmp_path: Path) -> None:
    path = {"a": [PoseSample(time_s, time_s / 10, math.sin(time_s), 0.0) for time_s in range(10)]}

    draw_trajectory(path, WORLD, tmp_path / "hall.png", "title")
    draw_trajectory(path, WORLD.model_copy(update={"beacons": (), "drops": ()}), tmp_path / "bare.png", "title")

    assert not np.array_equal(imread(tmp_path / "hall.png"), imread(tmp_path / "bare.png"))
