from __future__ import annotations

import math
from pathlib import Path

import pytest

from eal_actors.device.world import Beacon, BoxObstacle, CircleObstacle, load_world
from eal_actors.device.world.geometry import corners, covers, overlap
from tests.problems import problem_texts

HEAD = "version: 1\nname: room\nsize_m: [6, 4]\ntextures: {brick: {pattern: bricks}}\n"
ROOM = "the room, which reaches from -3 to 3 m in x and from -2 to 2 m in y"
CEILING = "the ceiling, which is 2.5 m high"
PILLAR = "obstacles: [{kind: circle, x_m: 0, y_m: 0, radius_m: 0.5}]"


def problems(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> list[str]:
    monkeypatch.chdir(tmp_path)
    Path("w.yaml").write_text(HEAD + text, encoding="utf-8")
    return problem_texts(lambda: load_world("w.yaml"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("surfaces: {floor: brik}", "5:19: surfaces.floor: no texture 'brik' in textures; did you mean 'brick'?"),
        (
            "boxes: [{name: a, x_m: 0, y_m: 0, texture: wood}]",
            "5:44: boxes[0].texture: no texture 'wood' in textures; known: brick",
        ),
        (
            "boxes: [{name: a, x_m: 0, y_m: 0}, {name: a, x_m: 1, y_m: 0}]",
            "5:43: boxes[1].name: boxes[0] is named 'a' already",
        ),
        (
            "beacons: [{name: a, x_m: 0, y_m: 0}, {name: a, x_m: 1, y_m: 0}]",
            "5:45: beacons[1].name: beacons[0] is named 'a' already",
        ),
        (
            "obstacles: [{kind: circle, x_m: 3.1, y_m: 0, radius_m: 1}]",
            f"5:13: obstacles[0]: its middle is outside {ROOM}",
        ),
        (
            "obstacles: [{kind: wall, start_m: [0, 0], end_m: [0, -2.1]}]",
            f"5:50: obstacles[0].end_m: is outside {ROOM}",
        ),
        ("boxes: [{name: a, x_m: 0, y_m: 2.1}]", f"5:9: boxes[0]: its middle is outside {ROOM}"),
        ("boxes: [{name: a, x_m: 2.9, y_m: 0}]", f"5:9: boxes[0]: it reaches out of {ROOM}"),
        ("places: {dok: {x_m: 9, y_m: 0}}", f"5:15: places.dok: it is outside {ROOM}"),
        (f"{PILLAR}\nplaces: {{dok: {{x_m: 0.2, y_m: 0}}}}", "6:15: places.dok: it is inside obstacles[0]"),
        (
            "places: {dok: {x_m: 0.2, y_m: 0.1}}\nkeep_out: [[[0, 0], [1, 0], [0, 1]]]",
            "5:15: places.dok: it is inside keep_out[0]",
        ),
        ("keep_out: [[[0, 0], [3.5, 0], [0, 1]]]", f"5:21: keep_out[0][1]: is outside {ROOM}"),
        ("keep_out: [[[0, 0], [1, 0]]]", "5:12: keep_out[0]: has 2 items, but needs at least 3"),
        (
            "keep_out: [[[0, 0], [1, 1], [1, 0], [0, 1]]]",
            "5:12: keep_out[0]: its edges from corner 0 and from corner 2 cross; list the corners in order",
        ),
        (
            "keep_out: [[[0, 0], [1, 1], [2, 2]]]",
            "5:12: keep_out[0]: its corners are on one line, so it encloses nothing",
        ),
        ("beacons: [{name: a, x_m: 9, y_m: 0}]", f"5:11: beacons[0]: its middle is outside {ROOM}"),
        ("drops: [{x_m: 0, y_m: -9, size_m: [1, 1]}]", f"5:9: drops[0]: its middle is outside {ROOM}"),
        (
            "lighting: {lamps: [{x_m: -4, y_m: 0}]}",
            f"5:20: lighting.lamps[0]: its middle is outside {ROOM}",
        ),
        (
            "lighting: {lamps: [{x_m: 0, y_m: 0, z_m: 3}]}",
            f"5:42: lighting.lamps[0].z_m: with 3 m it is above {CEILING}",
        ),
        (
            "obstacles: [{kind: wall, start_m: [0, 0], end_m: [1, 0], height_m: 2.6}]",
            f"5:68: obstacles[0].height_m: with 2.6 m it does not fit under {CEILING}",
        ),
        (
            "posters: [{wall: north, at_m: 2.6, texture: brick}]",
            ("5:11: posters[0]: from 2.1 to 3.1 m it does not fit on the north wall, which reaches from -3 to 3 m"),
        ),
        (
            "posters: [{wall: west, at_m: -1.6, texture: brick}]",
            ("5:11: posters[0]: from -2.1 to -1.1 m it does not fit on the west wall, which reaches from -2 to 2 m"),
        ),
        (
            "posters: [{wall: east, at_m: 0, bottom_m: 2, texture: brick}]",
            f"5:11: posters[0]: with its top at 2.7 m it does not fit under {CEILING}",
        ),
        (
            "posters:\n- {wall: east, at_m: 0, texture: brick}\n- {wall: east, at_m: 0.9, texture: brick}",
            "7:3: posters[1]: it overlaps posters[0] on the east wall",
        ),
        (
            "boxes: [{name: a, x_m: 0, y_m: 0}, {name: b, x_m: 0.2, y_m: 0.2}]",
            "5:36: boxes[1]: it overlaps boxes[0]",
        ),
        (f"{PILLAR}\nboxes: [{{name: a, x_m: 0.6, y_m: 0}}]", "6:9: boxes[0]: it overlaps obstacles[0]"),
        (
            "drops: [{x_m: 0, y_m: 0, size_m: [1, 1]}]\nboxes: [{name: a, x_m: 0.4, y_m: 0}]",
            "6:9: boxes[0]: its middle is over drops[0]",
        ),
        (
            f"{PILLAR}\nbeacons: [{{name: a, x_m: 0, y_m: 0.4}}]",
            "6:11: beacons[0]: it is inside obstacles[0], through which no robot finds it",
        ),
        ("starts: [{x_m: 0, y_m: 0}, {x_m: 0, y_m: 2.1}]", f"5:28: starts[1]: it is outside {ROOM}"),
        (
            "starts: [{x_m: 1, y_m: 0}, {x_m: 1, y_m: 0, yaw_deg: 9}]",
            "5:28: starts[1]: it is at the same place as starts[0]",
        ),
        (f"{PILLAR}\nstarts: [{{x_m: 0.3, y_m: 0.3}}]", "6:10: starts[0]: it is inside obstacles[0]"),
        (
            "obstacles: [{kind: wall, start_m: [-1, -1], end_m: [1, 1]}]\nstarts: [{x_m: 0.5, y_m: 0.5}]",
            "6:10: starts[0]: it is inside obstacles[0]",
        ),
        (
            "boxes: [{name: a, x_m: 0, y_m: 0}]\nstarts: [{x_m: 0.1, y_m: 0.1}]",
            "6:10: starts[0]: it is inside boxes[0]",
        ),
        (
            "beacons: [{name: a, x_m: 0, y_m: 0}]\nstarts: [{x_m: 0.01, y_m: 0}]",
            "6:10: starts[0]: it is inside beacons[0]",
        ),
        (
            "drops: [{x_m: 0, y_m: 0, size_m: [1, 1]}]\nstarts: [{x_m: 0.4, y_m: 0}]",
            "6:10: starts[0]: it is over drops[0]",
        ),
        (
            f"{PILLAR}\nstarts: {{shape: line, count: 3, spacing_m: 1}}",
            "6:9: starts: place 2 of the formation, x 0 m, y 0 m, is inside obstacles[0]",
        ),
        (
            "starts: {shape: column, count: 2, spacing_m: 1, x_m: 2.7}",
            f"5:9: starts: place 1 of the formation, x 3.2 m, y 0 m, is outside {ROOM}",
        ),
    ],
)
def test_what_cannot_be_is_told_with_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, expected: str
) -> None:
    assert problems(tmp_path, monkeypatch, text) == [f"w.yaml:{expected}"]


@pytest.mark.parametrize(
    "text",
    [
        "obstacles: [{kind: wall, start_m: [-3, 2], end_m: [3, -2], height_m: 2.5}]",  # from corner to corner
        f"{PILLAR}\nstarts: [{{x_m: 0.51, y_m: 0}}]",
        f"{PILLAR}\nboxes: [{{name: a, x_m: 0.65, y_m: 0}}]",
        f"{PILLAR}\nstarts: {{shape: circle, count: 4, spacing_m: 1}}",
        "obstacles: [{kind: circle, x_m: 0, y_m: 0, radius_m: 1}, {kind: circle, x_m: 1, y_m: 0, radius_m: 1}]",
        "boxes: [{name: a, x_m: 0, y_m: 0}, {name: b, x_m: 0.3, y_m: 0}]",  # side by side
        "boxes: [{name: a, x_m: 0, y_m: 0}]\nbeacons: [{name: a, x_m: 1, y_m: 0}]",
        "posters:\n- {wall: east, at_m: 0, texture: brick}\n- {wall: east, at_m: 1, texture: brick}",
        "posters:\n- {wall: east, at_m: 0, texture: brick}\n- {wall: west, at_m: 0, texture: brick}",
        "posters:\n- {wall: east, at_m: 0, texture: brick}\n- {wall: east, at_m: 0, bottom_m: 1.2, texture: brick}",
        "posters: [{wall: north, at_m: 2.5, bottom_m: 1.8, texture: brick}]",
    ],
)
def test_what_just_touches_is_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    assert problems(tmp_path, monkeypatch, text) == []


def test_problems_come_in_the_order_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "starts: [{x_m: 9, y_m: 9}]\nboxes: [{name: a, x_m: 9, y_m: 0, texture: x}]\nsurfaces: {walls: y}\n"

    found = problems(tmp_path, monkeypatch, text)

    assert [problem.split(": ")[1] for problem in found] == [
        "starts[0]",
        "boxes[0]",
        "boxes[0].texture",
        "surfaces.walls",
    ]


def block(x_m: float, y_m: float, along_m: float, across_m: float, yaw_deg: float = 0.0) -> BoxObstacle:
    return BoxObstacle(kind="box", x_m=x_m, y_m=y_m, size_m=(along_m, across_m), yaw_deg=yaw_deg)


def test_corners_turn_with_the_block() -> None:
    assert corners(block(1, 1, 4, 2)) == [(3, 2), (-1, 2), (-1, 0), (3, 0)]
    quarter = corners(block(0, 0, 4, 2, 90))
    assert [pytest.approx(corner) for corner in [(-1, 2), (-1, -2), (1, -2), (1, 2)]] == quarter


@pytest.mark.parametrize(
    ("x_m", "y_m", "expected"), [(0, 0, True), (1.3, 1.3, True), (1.5, 1.5, False), (1, 0, False), (0.6, 0, True)]
)
def test_a_slanted_block_covers_what_lies_along_it(x_m: float, y_m: float, expected: bool) -> None:
    assert (
        covers(block(0, 0, 4, 1, 45), x_m, y_m) is expected
    )  # it ends at 1.41 + 0.35 on its axis, 0.71 m on the x axis


def test_a_disc_covers_its_radius() -> None:
    pillar = CircleObstacle(kind="circle", x_m=1.0, y_m=0.0, radius_m=0.5)

    assert covers(pillar, 1.3, 0.4)
    assert not covers(pillar, 1.4, 0.4)
    assert covers(Beacon(name="b", x_m=0.0, y_m=0.0, radius_m=0.1), 0.0, 0.1)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (block(1.9, 0, 2, 2), True),
        (block(2.0, 0, 2, 2), False),
        (block(1.7, 1.7, 2, 2, 45), True),
        (block(1.72, 1.72, 2, 2, 45), False),  # their bounding boxes still overlap
        (block(0, 0, 0.1, 0.1, 10), True),  # wholly inside
        (CircleObstacle(kind="circle", x_m=1.5, y_m=0.0, radius_m=0.6), True),
        (CircleObstacle(kind="circle", x_m=1.5, y_m=0.0, radius_m=0.5), False),
        (CircleObstacle(kind="circle", x_m=1.5, y_m=1.5, radius_m=0.7), False),  # beyond the corner
        (CircleObstacle(kind="circle", x_m=1.5, y_m=1.5, radius_m=math.sqrt(0.5) + 0.01), True),
        (CircleObstacle(kind="circle", x_m=0.0, y_m=0.0, radius_m=0.1), True),
    ],
)
def test_blocks_overlap_when_they_share_more_than_an_edge(other: BoxObstacle | CircleObstacle, expected: bool) -> None:
    assert overlap(block(0, 0, 2, 2), other) is expected


def test_a_file_with_too_many_things_to_compare_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four thousand boxes took half a minute, and in one place all memory too."""
    boxes = "\n".join(f"- {{name: b{number}, x_m: 0, y_m: 0}}" for number in range(1001))
    found = problems(tmp_path, monkeypatch, f"boxes:\n{boxes}")
    assert found == ["w.yaml:6:1: boxes: has 1001 items, but may have at most 1000"]
    assert len(problems(tmp_path, monkeypatch, f"boxes:\n{boxes.rpartition(chr(10))[0]}")) == 1000


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("starts: {shape: grid, count: 10, spacing_m: 1e308}", "starts.spacing_m: must be at most 10000, not 1e+308"),
        ("beacons: [{name: a, x_m: 0, y_m: 0, radius_m: 1e308}]", "radius_m: must be at most 10000, not 1e+308"),
        (
            "obstacles: [{kind: wall, start_m: [1, 1], end_m: [1, 1.0000001]}]",
            "start_m and end_m are the same point",
        ),
    ],
)
def test_lengths_that_no_room_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, expected: str) -> None:
    """The first ended with a traceback, the others in a simulation that failed."""
    (found,) = problems(tmp_path, monkeypatch, text)
    assert found.endswith(expected)
