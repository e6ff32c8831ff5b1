"""plugins/sim/camera: what a camera sees, against geometry and against a ray caster."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors.device.world import load_world
from plugins.sim.camera import flat
from plugins.sim.camera.eye import Eye, PinholeLens
from plugins.sim.camera.movers import BoxAt, Mover, RobotAppearance, RobotAt
from plugins.sim.camera.render import render
from plugins.sim.camera.scene import Scene
from plugins.sim.models import MAKES, MakeName
from tests.unit.plugins.sim.ray_caster import cast, psnr_db
from tests.unit.plugins.sim.sensing import room

WORLDS = Path(__file__).parents[4] / "fleets" / "worlds"
SMALL, TINY = PinholeLens(320, 240), PinholeLens(160, 120)
PLAIN = {
    name: {"pattern": "plain", "colours": ((level, level, level),)}
    for name, level in (("dark", 0), ("grey", 100), ("pale", 255))
}


@cache
def scene(world: str) -> Scene:
    return Scene(load_world(WORLDS / f"{world}.yaml"))


@cache
def brick_room() -> Scene:
    bricks = {"bricks": {"pattern": "bricks", "colours": ((165, 80, 60), (190, 185, 175)), "tile_m": 0.8}}
    return Scene(room(textures=bricks, surfaces={"walls": "bricks"}))


def bare(width_m: float = 6.0, depth_m: float = 4.0, **parts: Any) -> Scene:
    """Return a white room in even light; `texture: dark` is black."""
    surfaces = {"floor": "pale", "walls": "pale", "ceiling": "pale"}
    return Scene(room(width_m, depth_m, textures=PLAIN, surfaces=surfaces, **parts))


def eye(x_m: float, y_m: float, yaw_deg: float, z_m: float = 0.2, lens: PinholeLens = SMALL) -> Eye:
    return Eye(x_m, y_m, z_m, math.radians(yaw_deg), lens)


def robot(make: MakeName, x_m: float, y_m: float, yaw_deg: float = 0.0, head_deg: float = 0.0) -> RobotAt:
    known = MAKES[make]
    look = RobotAppearance(known.radius_m, known.height_m, known.body_colour, known.camera_height_m)
    return RobotAt(look, x_m, y_m, math.radians(yaw_deg), math.radians(head_deg))


IN_LAB: tuple[Mover, ...] = (
    robot("roomba", 0.6, 0.2, 200),
    robot("evbot3", 1.4, -0.4, 150, 40),
    robot("evbot2", 0.9, 1.1, -100),
    robot("roomba", 2.4, 0.4, 30),
    BoxAt(0, 2.6, 1.2, 0.35),
)
IN_MAZE: tuple[Mover, ...] = (
    robot("roomba", -2.0, -0.8, 90),
    robot("evbot3", -1.0, -2.0, 10, 20),
    robot("evbot2", -2.0, 1.5, -20),
)


def dark_columns(image: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Return the columns that hold black pixels."""
    return np.flatnonzero((image < 64).all(axis=2).any(axis=0))


# Against the truth.


@pytest.mark.parametrize(
    ("x_m", "y_m", "yaw_deg", "z_m"),
    [
        pytest.param(-3.0, -2.2, 35, 0.4, marks=pytest.mark.slow),
        (0.0, -2.5, 90, 0.12),
        pytest.param(-0.2, 0.3, 0, 0.22, marks=pytest.mark.slow),
        pytest.param(3.2, 1.9, 200, 0.8, marks=pytest.mark.slow),
    ],
)
def test_frames_of_the_lab_agree_with_the_ray_caster(x_m: float, y_m: float, yaw_deg: float, z_m: float) -> None:
    place = eye(x_m, y_m, yaw_deg, z_m)
    assert psnr_db(render(scene("lab"), IN_LAB, place), cast(scene("lab"), IN_LAB, place)) > 35


@pytest.mark.parametrize(
    ("x_m", "y_m", "yaw_deg", "z_m"),
    [
        (-2, -2, 85, 0.22),
        pytest.param(-1, -1.2, -60, 0.4, marks=pytest.mark.slow),
        pytest.param(-2, 2, -40, 1.4, marks=pytest.mark.slow),
    ],
)
def test_frames_of_the_maze_agree_with_the_ray_caster(x_m: float, y_m: float, yaw_deg: float, z_m: float) -> None:
    place = eye(x_m, y_m, yaw_deg, z_m)
    assert psnr_db(render(scene("maze"), IN_MAZE, place), cast(scene("maze"), IN_MAZE, place)) > 35


@pytest.mark.parametrize("yaw_deg", range(0, 360, 40))
def test_a_copy_of_what_a_part_of_the_image_shows_of_a_texture_is_enough_to_warp_it(
    yaw_deg: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = [eye(x_m, 0.3, yaw_deg, z_m, PinholeLens()) for x_m, z_m in ((-1.5, 0.2), (0.4, 1.0))]
    frames = [render(scene("lab"), IN_LAB, look) for look in looks]
    monkeypatch.setattr(flat, "_MOST_COPIED", 0)
    for look, frame in zip(looks, frames, strict=True):
        difference = np.abs(render(scene("lab"), IN_LAB, look).astype(int) - frame)
        assert difference.max() <= 1  # OpenCV rounds the coordinates in a copy otherwise
        assert (difference > 0).mean() < 1e-3


def test_solids_that_cross_look_as_if_they_were_one() -> None:
    low = {"kind": "box", "x_m": 0.0, "y_m": 0.0, "size_m": (2.0, 0.3), "height_m": 0.3, "yaw_deg": 20}
    tall = {"kind": "box", "x_m": 0.2, "y_m": 0.0, "size_m": (0.3, 1.5), "height_m": 0.6, "texture": "grey"}
    pillar = {"kind": "circle", "x_m": -0.6, "y_m": -0.2, "radius_m": 0.2, "height_m": 1.0, "texture": "grey"}
    crossing = bare(obstacles=(low, tall, pillar))
    for x_m, y_m, yaw_deg, z_m in (
        (-2, 0.3, -5, 0.2),
        (-1.5, -1.5, 45, 0.8),
        (1.5, 1.2, 220, 0.45),
        (0, -1.7, 90, 0.25),
    ):
        place = eye(x_m, y_m, yaw_deg, z_m, TINY)
        assert psnr_db(render(crossing, [], place), cast(crossing, [], place)) > 35


def test_robots_and_boxes_hide_each_other_rightly() -> None:
    crate = {"name": "crate", "x_m": 0.0, "y_m": 0.0, "height_m": 0.2, "texture": "dark"}
    crowd = bare(boxes=(crate,))
    movers: list[Mover] = [
        robot("evbot3", -0.7, 0.1),
        BoxAt(0, -0.2, 0.05, 0.6),
        robot("roomba", 0.2, -0.1),
        robot("evbot2", 0.9, 0),
    ]
    for yaw_deg in (10, 100, 190, 280):
        x_m, y_m = -1.8 * math.cos(math.radians(yaw_deg)), -1.8 * math.sin(math.radians(yaw_deg))
        place = eye(x_m, y_m, yaw_deg, 0.3, TINY)
        assert psnr_db(render(crowd, movers, place), cast(crowd, movers, place)) > 35


@pytest.mark.parametrize("yaw_deg", [40, 89, 91, 270])
@pytest.mark.parametrize(("x_m", "y_m"), [(2.99, 0.3), (-2.99, -1.99), (0, 1.99)])
def test_a_camera_a_centimetre_from_a_wall_sees_it(x_m: float, y_m: float, yaw_deg: float) -> None:
    near = brick_room()
    place = eye(x_m, y_m, yaw_deg, lens=TINY)
    assert psnr_db(render(near, [], place), cast(near, [], place)) > 33, "so aslant, a pixel holds a metre of wall"


def test_a_camera_inside_or_at_the_edge_of_a_solid_draws_something() -> None:
    block = {"kind": "box", "x_m": 1.0, "y_m": 0.0, "size_m": (1.0, 1.0), "texture": "dark"}
    pillar = {"kind": "circle", "x_m": -1.0, "y_m": 0.0, "radius_m": 0.3}
    filled = bare(obstacles=(block, pillar))
    for x_m in (-1.0, -0.7, 0.5, 0.5 + 1e-12, 1.0):
        assert render(filled, [robot("evbot3", x_m, 0)], eye(x_m, 0, 0)).shape == (240, 320, 3)


# Geometry.


def test_what_is_to_the_left_is_left_in_the_image() -> None:
    post = {"kind": "circle", "x_m": 1.0, "y_m": 0.3, "radius_m": 0.05, "texture": "dark"}
    columns = dark_columns(render(bare(obstacles=(post,)), [], eye(0, 0, 0)))
    assert columns.max() < 160


@pytest.mark.parametrize("fov_deg", [30, 60, 90, 130])
@pytest.mark.parametrize("lens_px", [(640, 480), (321, 200)])
def test_an_edge_is_at_the_column_that_its_bearing_means(fov_deg: float, lens_px: tuple[int, int]) -> None:
    block = {"kind": "box", "x_m": 2.5, "y_m": 0.1, "size_m": (0.5, 0.5), "height_m": 2.5, "texture": "dark"}
    width, height = lens_px
    image = render(bare(obstacles=(block,)), [], eye(0, 0, 0, 0.3, PinholeLens(width, height, fov_deg)))
    row = image[height // 2, :, 0].astype(float) / image[height // 2, 0, 0]
    focal_px = width / 2 / math.tan(math.radians(fov_deg / 2))
    for y_m, edge in ((0.35, np.flatnonzero(row < 0.5).min()), (-0.15, np.flatnonzero(row < 0.5).max())):
        bearing_rad = math.atan2(y_m, 2.25)
        assert edge == pytest.approx((width - 1) / 2 - focal_px * math.tan(bearing_rad), abs=1)


def test_an_upper_edge_is_at_the_row_that_its_height_means() -> None:
    block = {"kind": "box", "x_m": 2.0, "y_m": 0.0, "size_m": (0.5, 3.0), "height_m": 0.5, "texture": "dark"}
    image = render(bare(obstacles=(block,)), [], eye(0, 0, 0, 0.3, PinholeLens()))
    dark = np.flatnonzero(image[:, 320, 0] < 100)
    focal_px = 320 / math.tan(math.radians(30))
    assert dark.min() == pytest.approx(239.5 - focal_px * 0.2 / 1.75, abs=1)
    assert dark.max() == pytest.approx(239.5 + focal_px * 0.3 / 1.75, abs=1)


@pytest.mark.parametrize("part", [0.0, 0.2, 0.4, 0.6, 0.8])
def test_edges_between_pixels_are_painted_in_part(part: float) -> None:
    y_m = 2.25 / SMALL.focal_px * part
    block = {"kind": "box", "x_m": 2.5, "y_m": y_m, "size_m": (0.5, 0.5), "height_m": 2.5, "texture": "dark"}
    row = render(bare(obstacles=(block,)), [], eye(0, 0, 0))[120, :, 0].astype(float)
    first = int(np.flatnonzero(row < 50).min())
    dark = 1 - row[first - 2 : first + 2] / row[first - 2]
    edge = first + 1.5 - dark.sum()
    assert edge == pytest.approx(SMALL.centre_px[0] - SMALL.focal_px * (y_m + 0.25) / 2.25, abs=0.05)


def test_a_robot_shows_where_it_faces_and_where_its_head_does() -> None:
    def picture(yaw_deg: float, head_deg: float) -> NDArray[np.uint8]:
        return render(bare(), [robot("evbot3", 1.0, 0.0, yaw_deg, head_deg)], eye(0, 0, 0))

    ahead = picture(180, 0)
    assert not np.array_equal(ahead, picture(0, 0))
    assert not np.array_equal(ahead, picture(180, 90))


def test_the_same_world_gives_the_same_frame_and_another_seed_another() -> None:
    bricks = {"bricks": {"pattern": "bricks", "colours": ((165, 80, 60), (190, 185, 175)), "tile_m": 0.2}}

    def picture(seed: int) -> NDArray[np.uint8]:
        model = room(textures=bricks, surfaces={"walls": "bricks"}, seed=seed)
        return render(Scene(model), [robot("roomba", 1, 0)], eye(0, 0, 0))

    assert np.array_equal(picture(3), picture(3))
    assert not np.array_equal(picture(3), picture(4))


def test_lamps_make_the_floor_below_them_brighter() -> None:
    lamp = {"x_m": 1.5, "y_m": 0.0, "z_m": 2.0, "lumens": 3000}
    lit = bare(lighting={"ambient_lux": 50, "lamps": (lamp,)})
    near, far = (render(lit, [], eye(x_m, 0, yaw_deg))[-1].mean() for x_m, yaw_deg in ((0.9, 0), (-0.9, 180)))
    assert near > 1.3 * far
