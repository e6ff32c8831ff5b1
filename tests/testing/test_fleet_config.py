"""The short notation for a test's robots and world."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from eal_actors.device.world import WorldModel
from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.testing.fleet_config import simulated_fleet
from tests.problems import problem_texts

ROOM: dict[str, Any] = {"version": 1, "name": "room", "size_m": (4, 3)}


def fleet(robots: Any, world: Any = None, seed: int | None = None, plugin_dirs: Any = ()) -> FleetConfig:
    return simulated_fleet(robots, world, seed, plugin_dirs)


def settings(config: FleetConfig, robot: str) -> object:
    return config.robots[robot].plugins["sim"].settings


def problems(robots: Any, world: Any = None, **options: Any) -> list[str]:
    return problem_texts(lambda: fleet(robots, world, **options))


def test_a_model_is_all_a_robot_needs() -> None:
    config = fleet({"scout": "roomba"})

    assert settings(config, "scout") == {"model": "roomba"}
    assert (config.name, config.rate, config.seed) == ("simulation", "max", 0)
    assert config.world is not None
    assert config.world.name == "empty"


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        ((1.0, 2.0), {"x_m": 1.0, "y_m": 2.0}),
        ([1, 2, 90], {"x_m": 1, "y_m": 2, "yaw_deg": 90}),
        ({"x_m": 1.0, "y_m": 2.0}, {"x_m": 1.0, "y_m": 2.0}),
    ],
)
def test_a_start_is_a_tuple_or_what_a_fleet_file_says(start: Any, expected: object) -> None:
    assert settings(fleet({"a": {"model": "evbot3", "start": start}}), "a") == {"model": "evbot3", "start": expected}


def test_keys_of_a_robot_are_told_from_settings_of_the_simulation() -> None:
    config = fleet({"a": {"model": "evbot2", "noise": False, "tags": ["x"], "timeout_s": 3, "plugins": {"sample": {}}}})
    robot = config.robots["a"]

    assert list(robot.plugins) == ["sim", "sample"]
    assert settings(config, "a") == {"model": "evbot2", "noise": False}
    assert (robot.tags, robot.timeout_s) == (("x",), 3)


def test_a_robot_need_not_be_simulated() -> None:
    assert list(fleet({"a": {"plugins": {"sample": {}}}}).robots["a"].plugins) == ["sample"]


def test_one_entry_may_make_many_robots() -> None:
    assert list(fleet({"r{n}": {"model": "roomba", "count": 3}}).robots) == ["r1", "r2", "r3"]


def test_a_world_is_named_or_given(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text("version: 1\nname: own\nsize_m: [2, 2]\n")
    model = WorldModel.model_validate(ROOM)

    worlds = [fleet({"a": "roomba"}, world).world for world in ("lab", file, str(file), ROOM, model)]

    assert [world.name for world in worlds if world] == ["lab", "own", "own", "room", "room"]


def test_a_fleet_file_brings_its_world_its_seed_and_its_plugins(tmp_path: Path) -> None:
    for folder in ("its", "ours"):
        (tmp_path / folder).mkdir()
    file = tmp_path / "fleet.yaml"
    file.write_text(
        "version: 1\nname: mine\nseed: 5\nclock: {rate: 2}\nworld: w.yaml\nplugin_dirs: [its]\n"
        "robots: {a: {plugins: {sim: {model: roomba}}}}\n"
    )
    (tmp_path / "w.yaml").write_text("version: 1\nname: w\nsize_m: [2, 2]\n")

    config = fleet(file)
    other = fleet(str(file), "lab", 6, [tmp_path / "ours"])

    assert (config.name, config.source, config.seed, config.rate) == ("mine", file, 5, "max")
    assert (other.name, other.seed, other.rate) == ("mine", 6, "max")
    assert config.world is not None
    assert other.world is not None
    assert (config.world.name, other.world.name) == ("w", "lab")
    assert [folder.name for folder in other.plugin_dirs] == ["ours", "its"]


def test_everything_wrong_is_told_at_once() -> None:
    wrong = problems({"1st": "roomba", "a": {"mailbox": 0, "model": "roomba"}}, "maez", seed=-1)

    assert wrong == [
        (
            "simulation: robots.1st: '1st' is not a name: a name is a letter (A-Z, a-z), then letters, digits, "
            "'_', '.' or '-', with {n} for a number"
        ),
        "simulation: robots.a.mailbox: must be over 0, not 0",
        "simulation: seed: must be at least 0, not -1",
        "simulation: world: there is no bundled world 'maez'; did you mean 'maze'?",
    ]


@pytest.mark.parametrize(
    ("robots", "message"),
    [
        ({}, "robots: the fleet has no robots; name at least one under 'robots'"),
        ({"a": None}, "robots.a: must be a mapping; write {} for an empty one"),
        ({"a": {}}, "robots.a: the robot has no plugins; give it one under 'plugins', or a type that has one"),
        (
            {"a": {"model": "roomba", "start": (1, 2, 3, 4)}},
            "robots.a.start: must be (x_m, y_m) or (x_m, y_m, yaw_deg), not (1, 2, 3, 4)",
        ),
        (
            {"a": {"noise": False, "plugins": {"sim": {"model": "roomba"}}}},
            "robots.a.plugins.sim: has settings in two places, also here: noise; put all of them in one place",
        ),
    ],
)
def test_robots_that_cannot_be(robots: Any, message: str) -> None:
    assert problems(robots) == [f"simulation: {message}"]


def test_files_that_are_not_there() -> None:
    assert problems("no.yaml") == ["no.yaml: no such file"]
    assert problems({"a": "roomba"}, "no/where.yaml") == ["no/where.yaml: no such file"]
    assert problems({"a": "roomba"}, plugin_dirs=["nowhere"]) == ["simulation: plugin_dirs[0]: no such folder: nowhere"]


def test_every_world_that_comes_with_the_framework_has_a_name() -> None:
    for file in bundled_path("fleets/worlds").glob("*.yaml"):
        world = fleet({"a": "roomba"}, file.stem).world
        assert world is not None
        assert world.name == file.stem
