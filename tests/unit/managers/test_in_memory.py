"""Fleets and worlds given in memory: the same checks, with the same words, as of files."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import pytest

from eal_actors.device.world import WorldModel, load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.config import EALConfigManager, world_of
from eal_actors.managers.memory_file import tree_of
from tests.problems import problem_texts

ROBOTS: dict[str, Any] = {"a": {"plugins": {"sample": {}}}}
ROOM: dict[str, Any] = {"version": 1, "name": "room", "size_m": (4, 3)}


def problems(content: Any) -> list[str]:
    return problem_texts(lambda: EALConfigManager.of(content, environment={}))


def world_problems(content: Any) -> list[str]:
    return problem_texts(lambda: world_of(content))


@pytest.mark.parametrize("name", ["sim", "local"])
def test_what_a_file_says_gives_the_same_fleet_from_memory(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bundled_path("fleets"))  # where the file's own paths lead from
    file = EALConfigManager.load(f"{name}.yaml").fleet

    fleet = EALConfigManager.of(load_yaml(f"{name}.yaml").root, name=name).fleet

    assert (fleet.name, fleet.seed, fleet.rate, fleet.world) == (file.name, file.seed, file.rate, file.world)
    assert fleet.source == Path(name)
    assert {name: robot.types for name, robot in fleet.robots.items()} == {
        name: robot.types for name, robot in file.robots.items()
    }
    for robot in file.robots.values():
        plugins = fleet.robots[robot.name].plugins
        assert {name: one.settings for name, one in plugins.items()} == {
            name: one.settings for name, one in robot.plugins.items()
        }


def test_robots_are_numbered_and_types_apply() -> None:
    content = {
        "version": 1,
        "types": {"kind": {"tags": ("x",), "plugins": {"sample": {}}}},
        "robots": {"r{n}": {"type": "kind", "range": (2, 3)}},
    }

    robots = EALConfigManager.of(content).fleet.robots

    assert list(robots) == ["r2", "r3"]
    assert robots["r2"].tags == ("x",)


def test_problems_have_a_path_and_no_line() -> None:
    assert problems({"version": 1, "robots": {"a": {"timeout_s": -1, "plugins": {"sample": {}}}}, "sed": 1}) == [
        "fleet: robots.a.timeout_s: must be over 0, not -1",
        "fleet: sed: unknown key 'sed'; did you mean 'seed'?",
    ]


def test_what_yaml_cannot_hold_is_refused_all_at_once() -> None:
    content = {1: "one", "version": 1, "robots": {"a": {"tags": [{"set"}], "since": datetime.date(2024, 1, 1)}}}

    assert problems(content) == [
        "fleet: a key must be text, not 1",
        "fleet: robots.a.since: must be what YAML can hold, not date: datetime.date(2024, 1, 1)",
        "fleet: robots.a.tags[0]: must be what YAML can hold, not set: {'set'}",
    ]


def test_files_that_it_builds_on_keep_their_lines(tmp_path: Path) -> None:
    part = tmp_path / "part.yaml"
    part.write_text("version: 1\nrobots:\n  a:\n    mailbox: ${SIZE}\n")

    assert problems({"version": 1, "include": [part], "robots": ROBOTS}) == [
        (
            f"{part}:4:14: robots.a.mailbox: the environment variable SIZE is not set; set it, or give a default: "
            "${SIZE:-default}"
        )
    ]


def test_paths_lead_from_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()

    fleet = EALConfigManager.of({"version": 1, "plugin_dirs": [Path("mine")], "robots": ROBOTS}).fleet

    assert fleet.plugin_dirs == (tmp_path.resolve() / "mine",)
    assert problems({"version": 1, "world": "w.yaml", "robots": ROBOTS}) == ["fleet: world: no such file: w.yaml"]


def test_text_stands_for_itself() -> None:
    robots = {"a": {"tags": ["${HOME}", "007"], "plugins": {"sample": {}}}}

    assert EALConfigManager.of({"version": 1, "robots": robots}).fleet.robots["a"].tags == ("${HOME}", "007")


def test_the_tree_is_a_copy() -> None:
    content: dict[str, Any] = {"robots": {"a": [1]}}
    tree = tree_of(content, "fleet")
    content["robots"]["a"].append(2)

    assert tree.root == {"robots": {"a": [1]}}


def test_a_world_from_memory_is_that_of_its_file() -> None:
    path = bundled_path("fleets/worlds/lab.yaml")

    assert world_of(load_yaml(path).root) == load_world(path)


def test_a_world_from_memory_is_checked_as_a_file_is() -> None:
    assert world_problems({"version": 1, "name": "room", "size_m": (4, 0), "hight_m": 2}) == [
        "world: hight_m: unknown key 'hight_m'; did you mean 'height_m'?",
        "world: size_m[1]: must be at least 0.001, not 0",
    ]


def test_a_model_made_in_python_is_checked_as_a_whole() -> None:
    good = WorldModel.model_validate(ROOM)
    bad = WorldModel.model_validate({**ROOM, "drops": ({"x_m": 9.0, "y_m": 0.0, "size_m": (1, 1)},)})

    assert world_of(good) is good
    assert [line.split(" its middle")[0] for line in world_problems(bad)] == ["world: drops[0]:"]
