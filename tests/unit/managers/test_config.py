from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from eal_actors.device.world import load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, RobotNotFoundError
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.config import EALConfigManager, fleet_schema, world_schema
from tests.problems import problems_of

SHIPPED_FLEETS = sorted(bundled_path("fleets").glob("*.yaml"))
SHIPPED_WORLDS = sorted(bundled_path("fleets/worlds").glob("*.yaml"))
FLEET_VALIDATOR = jsonschema.Draft202012Validator(fleet_schema())
WORLD_VALIDATOR = jsonschema.Draft202012Validator(world_schema())


@pytest.fixture
def sim() -> EALConfigManager:
    return EALConfigManager.load(bundled_path("fleets/sim.yaml"), environment={})


def names(robots: tuple[Any, ...]) -> list[str]:
    return [robot.name for robot in robots]


def test_the_simulated_fleet_is_as_promised(sim: EALConfigManager) -> None:
    fleet = sim.fleet

    assert (fleet.name, fleet.seed, fleet.rate) == ("sim", 7, 2.0)
    assert fleet.world is not None
    assert fleet.world.name == "empty"
    assert {robot.name: robot.plugins["sim"].settings["model"] for robot in fleet.robots.values()} == {
        "evbot2-1": "evbot2",
        "evbot3-1": "evbot3",
        "roomba-1": "roomba",
    }
    starts = [robot.plugins["sim"].settings["start"] for robot in fleet.robots.values()]
    assert [start["x_m"] for start in starts] == [-1.5, 0.0, 1.5]


def test_the_local_fleet_has_one_robot_with_the_sample_plugin() -> None:
    robot = EALConfigManager.load(bundled_path("fleets/local.yaml")).robot("local")

    assert list(robot.plugins) == ["sample"]


def test_a_robot_is_found_by_name(sim: EALConfigManager) -> None:
    assert sim.robot("roomba-1").type == "roomba"

    with pytest.raises(
        RobotNotFoundError, match=r"^the fleet 'sim' has no robot 'rooba-1'; did you mean 'roomba-1'\?$"
    ):
        sim.robot("rooba-1")


@pytest.mark.parametrize(
    ("criteria", "expected"),
    [
        ({}, ["evbot2-1", "evbot3-1", "roomba-1"]),
        ({"names": ["roomba-1", "evbot2-1"]}, ["evbot2-1", "roomba-1"]),
        ({"names": []}, []),
        ({"tags": ["wheeled"]}, ["evbot3-1", "roomba-1"]),
        ({"tags": "wheeled"}, ["evbot3-1", "roomba-1"]),
        ({"tags": ["vacuum", "tracked"]}, ["evbot2-1", "roomba-1"]),
        ({"types": ["evbot3"]}, ["evbot3-1"]),
        ({"tags": ["wheeled"], "names": ["evbot2-1", "evbot3-1"]}, ["evbot3-1"]),
        ({"tags": ["vacuum"], "types": ["evbot2"]}, []),
    ],
)
def test_robots_are_selected(sim: EALConfigManager, criteria: dict[str, Iterable[str]], expected: list[str]) -> None:
    assert names(sim.select(**criteria)) == expected


def test_a_type_selects_what_builds_on_it(tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(
        "version: 1\ntypes: {base: {plugins: {s: {}}}, own: {type: base}}\nrobots: {a: {type: own}, b: {type: base}}\n"
    )
    config = EALConfigManager.load(tmp_path / "f.yaml")

    assert names(config.select(types=["base"])) == ["a", "b"]
    assert names(config.select(types=["own"])) == ["a"]


@pytest.mark.parametrize(
    ("criteria", "message"),
    [
        ({"names": ["roomba-1", "evbot-1"]}, "has no robot 'evbot-1'; did you mean 'evbot3-1'?"),
        ({"tags": ["indor"]}, "has no robot of tag 'indor'; did you mean 'indoor'?"),
        ({"types": ["tank"]}, "has no robot of type 'tank'; known: evbot2, evbot3, roomba"),
    ],
)
def test_what_no_robot_has_cannot_be_selected(
    sim: EALConfigManager, criteria: dict[str, list[str]], message: str
) -> None:
    with pytest.raises(RobotNotFoundError) as caught:
        sim.select(**criteria)

    assert str(caught.value) == f"the fleet 'sim' {message}"


def test_the_environment_of_the_process_is_the_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "f.yaml"
    path.write_text("version: 1\nrobots:\n  r:\n    plugins:\n      s:\n        port: ${EAL_TEST_PORT}\n")
    monkeypatch.setenv("EAL_TEST_PORT", "5")

    assert EALConfigManager.load(path).robot("r").plugins["s"].settings == {"port": 5}
    with pytest.raises(ConfigError, match="EAL_TEST_PORT is not set"):
        EALConfigManager.load(path, environment={})


@pytest.mark.parametrize("path", SHIPPED_FLEETS, ids=lambda path: path.stem)
def test_shipped_fleets_are_right_by_model_and_schema(path: Path) -> None:
    EALConfigManager.load(path, environment={})
    FLEET_VALIDATOR.validate(load_yaml(path).root)


@pytest.mark.parametrize("path", SHIPPED_WORLDS, ids=lambda path: path.stem)
def test_shipped_worlds_are_right_by_model_and_schema(path: Path) -> None:
    load_world(path)
    WORLD_VALIDATOR.validate(load_yaml(path).root)


def test_both_kinds_of_files_are_shipped() -> None:
    assert {path.stem for path in SHIPPED_FLEETS} >= {"local", "sim", "swarm"}
    assert {path.stem for path in SHIPPED_WORLDS} >= {"empty", "field", "lab", "maze"}


ROBOTS = "robots: {r: {plugins: {s: {}}}}"


@pytest.mark.parametrize(
    "text",
    [
        ROBOTS,
        f"version: 2\n{ROBOTS}",
        f"version: true\n{ROBOTS}",
        f"version: 1\nsede: 1\n{ROBOTS}",
        f"version: 1\nseed: -1\n{ROBOTS}",
        f"version: 1\nseed: 1.5\n{ROBOTS}",
        f"version: 1\nname: 1a\n{ROBOTS}",
        f"version: 1\nclock: {{rate: 0}}\n{ROBOTS}",
        f"version: 1\nclock: {{rate: '1'}}\n{ROBOTS}",
        f"version: 1\ninclude: x.yaml\n{ROBOTS}",
        f"version: 1\ndefaults: {{restart: never}}\n{ROBOTS}",
        f"version: 1\ndefaults: {{type: t}}\n{ROBOTS}",
        f"version: 1\ntypes: {{1t: {{}}}}\n{ROBOTS}",
        "version: 1\nrobots: {1r: {plugins: {s: {}}}}",
        "version: 1\nrobots: {'{n}r': {count: 1, plugins: {s: {}}}}",
        "version: 1\nrobots: {r: {plugins: {s: }}}",
        "version: 1\nrobots: {r: {plugins: {a b: {}}}}",
        "version: 1\nrobots: {r: {plugins: {s: {plugin: 5}}}}",
        "version: 1\nrobots: {'r{n}': {range: [1], plugins: {s: {}}}}",
        "version: 1\nrobots: {'r{n}': {count: 10001, plugins: {s: {}}}}",
        "version: 1\nrobots: {r: {mailbox: 0, plugins: {s: {}}}}",
        "version: 1\nrobots: {r: {tags: [''], plugins: {s: {}}}}",
    ],
)
def test_model_and_schema_refuse_the_same_fleets(tmp_path: Path, text: str) -> None:
    check_refusal(tmp_path / "f.yaml", text, EALConfigManager.load, FLEET_VALIDATOR)


def check_refusal(
    path: Path, text: str, load: Callable[[Path], object], validator: jsonschema.Draft202012Validator
) -> None:
    """Check that a file has one problem, and that the schema refuses it too."""
    path.write_text(text)
    assert len(problems_of(lambda: load(path))) == 1
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(load_yaml(path).root)


@pytest.mark.parametrize(
    "rest",
    [
        "size_m: [1]",
        "size_m: [1, 2, 3]",
        "size_m: [0, 1]",
        "size_m: [1, 1]\nobstacles: [{kind: ball}]",
        "size_m: [1, 1]\nobstacles: [{kind: circle, x_m: 0, y_m: 0, radius_m: 0}]",
        "size_m: [1, 1]\nobstacles: [{kind: circle, x_m: 0, y_m: 0, radius_m: 1, width_m: 1}]",
        "size_m: [1, 1]\nobstacles: [{kind: box, x_m: 0, y_m: 0, size_m: [1], height_m: 1}]",
        "size_m: [1, 1]\nobstacles: [{kind: box, x_m: 0, y_m: 0, size_m: [1, 1], height_m: 0}]",
        "size_m: [1, 1]\nobstacles: [{kind: wall, start_m: [0, 0]}]",
        "size_m: [1, 1]\nheight_m: 0",
        "size_m: [1, 1]\nseed: -1",
        "size_m: [1, 1]\ntextures: {1a: {pattern: plain}}",
        "size_m: [1, 1]\ntextures: {a: {pattern: checkers}}",
        "size_m: [1, 1]\ntextures: {a: {pattern: plain, colours: []}}",
        "size_m: [1, 1]\ntextures: {a: {pattern: plain, colours: [[1, 2, 256]]}}",
        "size_m: [1, 1]\nposters: [{wall: up, at_m: 0, texture: a}]",
        "size_m: [1, 1]\nboxes: [{x_m: 0, y_m: 0}]",
        "size_m: [1, 1]\nbeacons: [{name: a, x_m: 0, y_m: 0, colour: [1, 2]}]",
        "size_m: [1, 1]\ndrops: [{x_m: 0, y_m: 0, size_m: [1, 0]}]",
        "size_m: [1, 1]\nlighting: {ambient_lux: -1}",
        "size_m: [1, 1]\nstarts: 5",
        "size_m: [1, 1]\nstarts: [{x_m: 0, y_m: 0, yaw_deg: 361}]",
        "size_m: [1, 1]\nstarts: {shape: ring, count: 1, spacing_m: 1}",
        "size_m: [1, 1]\nstarts: {shape: line, count: 0, spacing_m: 1}",
        "size_m: [1, 1]\nphysics: {rate_hz: 1001}",
    ],
)
def test_model_and_schema_refuse_the_same_worlds(tmp_path: Path, rest: str) -> None:
    check_refusal(tmp_path / "w.yaml", f"version: 1\nname: w\n{rest}\n", load_world, WORLD_VALIDATOR)


def test_the_schema_describes_the_keys() -> None:
    schema = fleet_schema()

    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["properties"]["seed"]["description"] == "The seed of all random generators of the fleet."
