"""plugins/sim/camera: textures, light, and solids that overlap."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pytest

from eal_actors.device.world import SurfaceTexture as TextureModel
from plugins.sim.camera.cutting import without_overlaps
from plugins.sim.camera.light import SIDES, RoomLight
from plugins.sim.camera.patterns import PatternCanvas, draw
from plugins.sim.camera.shared import scene_of
from plugins.sim.camera.solids import Block, Face, Plane
from plugins.sim.camera.texture import PAD, Mipmap, samples
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock
from tests.unit.plugins.sim.sensing import room

PALETTE = ((240, 235, 220), (200, 60, 50), (50, 90, 170), (240, 190, 60))
PATTERNS = ["plain", "checker", "stripes", "planks", "bricks", "plaster", "mosaic", "poster"]


def canvas(
    size_m: tuple[float, float] = (1.0, 1.0), per_m: float = 300.0, seed: int = 0, **parts: Any
) -> PatternCanvas:
    columns, rows = (samples(length_m, per_m) for length_m in size_m)
    return PatternCanvas(columns, rows, size_m, np.random.default_rng(seed), **parts)


def drawn(pattern: str, on: PatternCanvas, **parts: Any) -> Any:
    return draw(TextureModel.model_validate({"pattern": pattern, "colours": PALETTE, **parts}), on)


# Textures.


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("size_m", [(1.0, 1.0), (0.05, 2.0), (3.0, 0.1)])
def test_every_pattern_fits_every_surface(pattern: str, size_m: tuple[float, float]) -> None:
    on = canvas(size_m, 120)
    image = drawn(pattern, on)
    assert image.shape == (on.rows, on.columns, 3)
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    assert np.array_equal(image, drawn(pattern, canvas(size_m, 120)))


@pytest.mark.parametrize("pattern", ["checker", "stripes", "planks", "bricks", "plaster", "mosaic"])
def test_a_pattern_round_a_pillar_has_no_seam(pattern: str) -> None:
    on = canvas((1.1, 0.6), wraps=True)
    image = drawn(pattern, on, colours=PALETTE[:2], tile_m=0.2)
    steps = np.abs(np.diff(image, axis=1)).mean(axis=(0, 2))
    seam = np.abs(image[:, 0] - image[:, -1]).mean()
    assert seam <= steps.max() + 1


def test_mosaics_and_posters_are_rich_in_features() -> None:
    def features(pattern: str) -> int:
        image = np.clip(drawn(pattern, canvas((1.0, 1.0), 420), tile_m=0.1), 0, 255).astype(np.uint8)
        return len(cv2.SIFT.create().detect(image, None))

    assert features("mosaic") > 300
    assert features("poster") > 300
    assert features("plain") < 50


def test_another_seed_draws_another_poster() -> None:
    assert not np.array_equal(drawn("poster", canvas(seed=1)), drawn("poster", canvas(seed=2)))


def test_coarser_versions_keep_their_samples_where_they_are() -> None:
    ramp = np.zeros((33, 65, 4), np.uint8)
    ramp[:] = (np.arange(65) * 3)[:, np.newaxis]
    texture = Mipmap(ramp, (1.0, 0.5))
    for along in range(4):
        version = texture.version(along, 1)[PAD:-PAD, PAD:-PAD]
        assert version.shape == (17, 64 // 2**along + 1, 4)
        inner = version[:, 1:-1, 0].astype(int)
        assert np.abs(inner - np.arange(64 // 2**along + 1)[1:-1] * 3 * 2**along).max() <= 1


def test_levels_follow_the_samples_in_a_pixel() -> None:
    texture = Mipmap(np.zeros((33, 65, 4), np.uint8), (1.0, 0.5))
    assert [texture.level(count, 0) for count in (0.01, 1, 2.5, 5, 1e9)] == [0, 0, 1, 2, 6]
    for level in range(5):
        assert [texture.level(share * texture.most(level), 1) for share in (0.99, 1.01)] == [level, level + 1]


# RoomLight.


def test_light_falls_off_with_distance_and_slant() -> None:
    lamp = {"x_m": 0.0, "y_m": 0.0, "z_m": 2.0, "lumens": 4 * math.pi * 100}
    light = RoomLight(room(lighting={"ambient_lux": 0, "lamps": (lamp,)}))
    up = np.array([0.0, 0.0, 1.0])
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [2.0, 0.0, 0.0]])
    assert light.lux(places, up) == pytest.approx([25.0, 100.0, 12.5 / math.sqrt(2)])
    assert light.lux(places[:1], -up) == pytest.approx([0.0])


def test_light_round_a_place_is_brightest_towards_the_lamp() -> None:
    lamp = {"x_m": 2.0, "y_m": 0.0, "z_m": 1.0}
    gains = RoomLight(room(lighting={"ambient_lux": 10, "lamps": (lamp,)})).around(np.array([[0.0, 0.0, 0.5]]))[0]
    assert len(gains) == SIDES + 2
    assert gains[: SIDES + 1].argmax() == SIDES // 2
    assert gains[0] == pytest.approx(gains[SIDES])
    assert gains[0] == pytest.approx(gains[: SIDES + 1].min())


def test_a_dark_room_is_not_divided_by_zero() -> None:
    light = RoomLight(room(lighting={"ambient_lux": 0}))
    assert light.gain(np.zeros((1, 3)), np.array([0.0, 0.0, 1.0])) == pytest.approx([0.0])


# Cutting.


def block(x_m: float, y_m: float, size_m: tuple[float, float], yaw_deg: float, height_m: float) -> Block:
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    halves = [(-size_m[0] / 2, -size_m[1] / 2), (size_m[0] / 2, -size_m[1] / 2)]
    halves += [(-x, -y) for x, y in halves]
    corners = tuple((x_m + cos * x - sin * y, y_m + sin * x + cos * y) for x, y in halves)
    texture = Mipmap(np.zeros((3, 3, 4), np.uint8), (1.0, 1.0))
    ends = [*corners, corners[0]]
    faces = tuple(Face(left, right, 0.0, height_m, texture) for left, right in pairwise(ends))
    return Block(corners, height_m, faces, Plane(height_m, (x_m, y_m), 0.0, texture))


def covers(one: Block, x_m: float, y_m: float) -> bool:
    ends = [*one.corners, one.corners[0]]
    return all((x1 - x0) * (y_m - y0) - (y1 - y0) * (x_m - x0) > 0 for (x0, y0), (x1, y1) in pairwise(ends))


def test_cut_blocks_cover_the_same_without_overlaps_and_the_tallest_stays() -> None:
    generator, heights_m = np.random.default_rng(7), (0.5, 1.0, 0.5, 2.0)
    for _ in range(20):
        parts = generator.uniform((-1, -1, 0.2, 0.2, 0), (1, 1, 2, 2, 180), (4, 5)).tolist()
        blocks = [
            block(x_m, y_m, (length_m, width_m), yaw_deg, height_m)
            for (x_m, y_m, length_m, width_m, yaw_deg), height_m in zip(parts, heights_m, strict=True)
        ]
        cut = without_overlaps(blocks)
        for x_m, y_m in generator.uniform(-2, 2, (100, 2)).tolist():
            heights = [one.height_m for one in blocks if covers(one, x_m, y_m)]
            assert [one.height_m for one in cut if covers(one, x_m, y_m)] == ([max(heights)] if heights else [])


def test_blocks_apart_are_left_alone() -> None:
    blocks = [block(0, 0, (1, 1), 0, 1.0), block(1, 0, (1, 1), 0, 0.5), block(3, 0, (1, 1), 45, 0.5)]
    assert without_overlaps(blocks) == blocks


def test_a_cut_face_keeps_its_place_on_the_texture() -> None:
    wall, gate = block(0, 0, (4, 0.2), 0, 0.5), block(0.5, 0, (0.4, 1.0), 0, 1.0)
    front = [face for part in without_overlaps([wall, gate]) if part.height_m == 0.5 for face in part.faces]
    south = sorted((face for face in front if face.normal[1] < -0.9), key=lambda face: face.left)
    assert [(face.left[0], face.right[0], face.offset_m) for face in south] == [
        pytest.approx((-2.0, 0.3, 0.0)),
        pytest.approx((0.7, 2.0, 2.7)),
    ]


# The scene of a world.


def test_equal_worlds_one_after_the_other_have_one_scene() -> None:
    first, equal, other = (SimWorld(ManualClock(), 1, room(width_m)) for width_m in (2.0, 2.0, 2.5))
    scene = scene_of(first)
    assert scene_of(equal) is scene
    assert scene_of(other) is not scene
    assert scene_of(first) is scene
