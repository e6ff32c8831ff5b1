from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.bundled import bundled_path
from eal_actors.errors import ConfigError
from eal_actors.world import BoxObstacle, CircleObstacle, Physics, WorldModel, load_world

HEAD = "version: 1\nname: room\nsize_m: [6, 4]\n"


def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> WorldModel:
    monkeypatch.chdir(tmp_path)
    Path("w.yaml").write_text(text, encoding="utf-8")
    return load_world("w.yaml")


def test_a_world_is_read_with_its_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = load(tmp_path, monkeypatch, HEAD)

    assert world == WorldModel(version=1, name="room", size_m=(6.0, 4.0), obstacles=(), physics=Physics(rate_hz=50.0))


def test_obstacles_are_told_apart_by_their_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = f"""{HEAD}obstacles:
  - {{kind: box, x_m: 1, y_m: -0.5, width_m: 2, height_m: 1}}
  - {{kind: circle, x_m: 0, y_m: 0, radius_m: 0.25}}
physics: {{rate_hz: 100}}
"""
    world = load(tmp_path, monkeypatch, text)

    assert world.obstacles == (
        BoxObstacle(kind="box", x_m=1.0, y_m=-0.5, width_m=2.0, height_m=1.0, yaw_deg=0.0),
        CircleObstacle(kind="circle", x_m=0.0, y_m=0.0, radius_m=0.25),
    )
    assert world.physics.rate_hz == 100.0


@pytest.mark.parametrize("name", ["empty", "lab"])
def test_the_shipped_worlds_are_right(name: str) -> None:
    world = load_world(bundled_path(f"fleets/worlds/{name}.yaml"))

    assert world.name == name
    for obstacle in world.obstacles:
        assert abs(obstacle.x_m) < world.size_m[0] / 2
        assert abs(obstacle.y_m) < world.size_m[1] / 2


def test_a_bad_world_is_told_of_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = """version: 1
size_m: [6, -4]
obstacles:
  - {kind: box, x_m: 1, y_m: 1, width_m: 1, heigth_m: 1}
  - {kind: circel, x_m: 1, y_m: 1, radius_m: 1}
  - {kind: circle, x_m: "1", y_m: 1, radius_m: 0}
physics: {rate_hz: 0}
"""
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, monkeypatch, text)

    assert str(caught.value).splitlines() == [
        "w.yaml:1:1: name: is missing",
        "w.yaml:2:13: size_m[1]: must be over 0, not -4",
        "w.yaml:4:5: obstacles[0].height_m: is missing",
        "w.yaml:4:45: obstacles[0].heigth_m: unknown key 'heigth_m'; did you mean 'height_m'?",
        "w.yaml:5:12: obstacles[1].kind: must be one of 'box', 'circle', not 'circel'; did you mean 'circle'?",
        "w.yaml:6:25: obstacles[2].x_m: must be a number, not '1'",
        "w.yaml:6:48: obstacles[2].radius_m: must be over 0, not 0",
        "w.yaml:7:20: physics.rate_hz: must be over 0, not 0",
    ]


def test_the_environment_has_no_say_in_a_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROOM", "hall")

    with pytest.raises(ConfigError, match=r"'\$\{ROOM\}' is not a name"):
        load(tmp_path, monkeypatch, "version: 1\nname: ${ROOM}\nsize_m: [6, 4]\n")
