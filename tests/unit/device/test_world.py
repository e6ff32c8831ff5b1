from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.device.world import (
    Beacon,
    BoxObstacle,
    CircleObstacle,
    Drop,
    Formation,
    Lamp,
    MovableBox,
    Partition,
    Physics,
    Poster,
    StartPose,
    SurfaceTexture,
    WorldModel,
    load_world,
)
from eal_actors.kernel.errors import ConfigError

HEAD = "version: 1\nname: room\nsize_m: [6, 4]\n"


def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> WorldModel:
    monkeypatch.chdir(tmp_path)
    Path("w.yaml").write_text(text, encoding="utf-8")
    return load_world("w.yaml")


def test_a_world_is_read_with_its_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = load(tmp_path, monkeypatch, HEAD)

    assert world == WorldModel(version=1, name="room", size_m=(6.0, 4.0))
    assert (world.height_m, world.seed, world.physics) == (2.5, 0, Physics(rate_hz=50.0))
    assert (world.obstacles, world.boxes, world.beacons, world.drops, world.posters) == ((), (), (), (), ())
    assert (world.lighting.ambient_lux, world.lighting.lamps, world.start_poses) == (150.0, (), ())


def test_every_part_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = f"""{HEAD}textures:
  brick: {{pattern: bricks, colours: [[165, 80, 60], [190, 185, 175]], tile_m: 0.2}}
surfaces: {{floor: brick}}
posters: [{{wall: east, at_m: 1, texture: brick}}]
obstacles:
  - {{kind: box, x_m: 1, y_m: -0.5, size_m: [2, 1], height_m: 1}}
  - {{kind: circle, x_m: 0, y_m: 1, radius_m: 0.25, texture: brick}}
  - {{kind: wall, start_m: [-2, 0], end_m: [-2, 2]}}
boxes: [{{name: crate, x_m: -1, y_m: -1, mass_kg: 2}}]
beacons: [{{name: dock, x_m: 2.5, y_m: 1.5, colour: [1, 2, 3]}}]
drops: [{{x_m: 2, y_m: -1.5, size_m: [0.5, 0.5], yaw_deg: 45}}]
lighting: {{ambient_lux: 0, lamps: [{{x_m: 0, y_m: 0, lumens: 500}}]}}
starts: [{{x_m: -2.5, y_m: -1, yaw_deg: 90}}]
physics: {{rate_hz: 100}}
"""
    world = load(tmp_path, monkeypatch, text)

    brick = SurfaceTexture(pattern="bricks", colours=((165, 80, 60), (190, 185, 175)), tile_m=0.2)
    assert world.textures == {"brick": brick}
    assert (world.surfaces.floor, world.surfaces.walls) == ("brick", None)
    assert world.posters == (Poster(wall="east", at_m=1.0, bottom_m=0.5, size_m=(1.0, 0.7), texture="brick"),)
    assert world.obstacles == (
        BoxObstacle(kind="box", x_m=1.0, y_m=-0.5, size_m=(2.0, 1.0), yaw_deg=0.0, height_m=1.0),
        CircleObstacle(kind="circle", x_m=0.0, y_m=1.0, radius_m=0.25, height_m=0.8, texture="brick"),
        Partition(kind="wall", start_m=(-2.0, 0.0), end_m=(-2.0, 2.0), thickness_m=0.1, height_m=0.8),
    )
    assert world.boxes == (MovableBox(name="crate", x_m=-1.0, y_m=-1.0, mass_kg=2.0),)
    assert world.beacons == (Beacon(name="dock", x_m=2.5, y_m=1.5, colour=(1, 2, 3)),)
    assert world.drops == (Drop(x_m=2.0, y_m=-1.5, size_m=(0.5, 0.5), yaw_deg=45.0),)
    assert world.lighting.lamps == (Lamp(x_m=0.0, y_m=0.0, z_m=2.4, lumens=500.0),)
    assert world.start_poses == (StartPose(x_m=-2.5, y_m=-1.0, yaw_deg=90.0),)
    assert world.physics.rate_hz == 100.0


def test_a_formation_is_read_as_the_poses_that_it_means(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = load(tmp_path, monkeypatch, f"{HEAD}starts: {{shape: line, count: 2, spacing_m: 1, x_m: 1}}\n")

    assert world.starts == Formation(shape="line", count=2, spacing_m=1.0, x_m=1.0)
    assert world.start_poses == (StartPose(x_m=1.0, y_m=0.5), StartPose(x_m=1.0, y_m=-0.5))


@pytest.mark.parametrize(
    ("start_m", "end_m", "middle_m", "length_m", "yaw_deg"),
    [
        ((0.0, 0.0), (2.0, 0.0), (1.0, 0.0), 2.0, 0.0),
        ((1.0, -2.0), (1.0, 1.0), (1.0, -0.5), 3.0, 90.0),
        ((0.0, 0.0), (-3.0, -4.0), (-1.5, -2.0), 5.0, math.degrees(math.atan2(-4, -3))),
    ],
)
def test_a_partition_is_a_block(
    start_m: tuple[float, float],
    end_m: tuple[float, float],
    middle_m: tuple[float, float],
    length_m: float,
    yaw_deg: float,
) -> None:
    wall = Partition(kind="wall", start_m=start_m, end_m=end_m, thickness_m=0.2, height_m=1.5, texture="brick")
    world = WorldModel(version=1, name="w", size_m=(9.0, 9.0), obstacles=(wall,))

    assert world.solid_obstacles == (wall.as_box(),)
    block = wall.as_box()
    assert (block.x_m, block.y_m) == middle_m
    assert block.size_m == (length_m, 0.2)
    assert block.yaw_deg == pytest.approx(yaw_deg)
    assert (block.height_m, block.texture) == (1.5, "brick")


def test_a_bad_world_is_told_of_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = """version: 1
size_m: [6, -4]
obstacles:
  - {kind: box, x_m: 1, y_m: 1, size_m: [1, 1], heigth_m: 1}
  - {kind: circel, x_m: 1, y_m: 1, radius_m: 1}
  - {kind: circle, x_m: "1", y_m: 1, radius_m: 0}
  - {kind: wall, start_m: [1, 1], end_m: [1, 1]}
physics: {rate_hz: 0}
"""
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, monkeypatch, text)

    assert str(caught.value).splitlines() == [
        "w.yaml:1:1: name: is missing",
        "w.yaml:2:13: size_m[1]: must be at least 0.001, not -4",
        "w.yaml:4:49: obstacles[0].heigth_m: unknown key 'heigth_m'; did you mean 'height_m'?",
        "w.yaml:5:12: obstacles[1].kind: must be one of 'box', 'circle', 'wall', not 'circel'; did you mean 'circle'?",
        "w.yaml:6:25: obstacles[2].x_m: must be a number, not '1'",
        "w.yaml:6:48: obstacles[2].radius_m: must be at least 0.001, not 0",
        "w.yaml:7:5: obstacles[3]: start_m and end_m are the same point",
        "w.yaml:8:20: physics.rate_hz: must be at least 5, not 0",
    ]


FORMS = "must be a list of start poses, or a formation: a mapping with shape, count and spacing_m"
SHAPES = "'line', 'column', 'grid', 'circle' or 'wedge'"


@pytest.mark.parametrize(
    ("starts", "expected"),
    [
        ("5", [f"9: starts: {FORMS}"]),
        ("", [f"8: starts: {FORMS}"]),
        ("[5]", ["10: starts[0]: must be a mapping, not 5"]),
        ("[{x_m: 1}]", ["10: starts[0].y_m: is missing"]),
        ("[{x_m: 1, y_m: 0, yaw: 3}]", ["27: starts[0].yaw: unknown key 'yaw'; did you mean 'yaw_deg'?"]),
        ("[{x_m: 1, y_m: 0, yaw_deg: 361}]", ["36: starts[0].yaw_deg: must be at most 360, not 361"]),
        (
            "[{shape: line, count: 3, spacing_m: 1}]",
            ["10: starts[0]: is a formation; write it without a list: `starts: {shape: ...}`"],
        ),
        (
            "{shape: lin, count: 1, spacing_m: 1}",
            [f"17: starts.shape: must be {SHAPES}, not 'lin'; did you mean 'line'?"],
        ),
        (
            "{shape: line, count: 0, spacing: 1}",
            [
                "9: starts.spacing_m: is missing",
                "30: starts.count: must be at least 1, not 0",
                "33: starts.spacing: unknown key 'spacing'; did you mean 'spacing_m'?",
            ],
        ),
        ("{shape: line, count: 10001, spacing_m: 1}", ["30: starts.count: must be at most 10000, not 10001"]),
    ],
)
def test_of_starts_only_what_is_wrong_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, starts: str, expected: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, monkeypatch, f"{HEAD}starts: {starts}\n")

    assert str(caught.value).splitlines() == [f"w.yaml:4:{problem}" for problem in expected]


@pytest.mark.parametrize(
    ("colours", "expected"),
    [
        ("[]", "textures.a.colours: needs at least one colour"),
        ("[red]", "textures.a.colours[0]: must be a list, not 'red'"),
        ("[[1, 2]]", "textures.a.colours[0][2]: is missing"),
        ("[[1, 2, 256]]", "textures.a.colours[0][2]: must be at most 255, not 256"),
    ],
)
def test_a_bad_colour_is_one_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, colours: str, expected: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, monkeypatch, f"{HEAD}textures: {{a: {{pattern: plain, colours: {colours}}}}}\n")

    assert [str(problem).split(": ", 1)[1] for problem in caught.value.problems] == [expected]


def test_the_environment_has_no_say_in_a_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROOM", "hall")

    with pytest.raises(ConfigError, match=r"'\$\{ROOM\}' is not a name"):
        load(tmp_path, monkeypatch, "version: 1\nname: ${ROOM}\nsize_m: [6, 4]\n")


def test_worlds_are_read_without_numpy() -> None:
    program = "import sys; sys.modules['numpy'] = None; import eal_actors.device.world"
    subprocess.run([sys.executable, "-c", program], cwd=Path(__file__).parents[3], check=True, timeout=60)
