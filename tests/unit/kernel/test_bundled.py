"""Bundled files are found by name; a path or a local file of that name takes precedence."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.device.world import load_world
from eal_actors.facade.eal import connect
from eal_actors.kernel.bundled import Kind, bundled_names, bundled_path, find_file, find_files
from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario

FLEET = "version: 1\nname: mine\nworld: {world}\nrobots: {{r: {{plugins: {{sim: {{model: roomba}}}}}}}}\n"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "kind", "shipped"),
    [
        ("sim", "fleet", "fleets/sim.yaml"),
        ("dance", "scenario", "scenarios/dance.yaml"),
        ("patrol-visit", "scenario", "scenarios/patrol-visit.yaml"),
        ("lab", "world", "fleets/worlds/lab.yaml"),
        ("lab", "fleet", "fleets/lab.yaml"),
    ],
)
def test_a_name_means_what_is_shipped(name: str, kind: Kind, shipped: str) -> None:
    assert find_file(name, kind) == bundled_path(shipped)


@pytest.mark.parametrize("file", ["sim", "sim.yaml"])
def test_a_file_of_that_name_here_goes_before_it(file: str, here: Path) -> None:
    (here / file).write_text("")

    assert find_file("sim", "fleet") == Path(file)


@pytest.mark.parametrize("path", ["my.yaml", "fleets/my", "fleets/my.yaml", "/my", "../my", "sim.txt", "", ".", "/"])
def test_a_path_means_itself(path: str) -> None:
    assert find_file(path, "fleet") == Path(path)
    assert find_files(path) == (Path(path),)


@pytest.mark.parametrize("path", ["sim.yaml", "fleets/sim", "fleets/sim.yaml", "../sim"])
def test_a_path_of_a_checkout_is_told_the_name(path: str, here: Path) -> None:
    for find in (lambda: find_file(path, "fleet"), lambda: find_files(path)):
        with pytest.raises(ConfigError, match=r"sim.*: no such file; the framework has one: write 'sim'$"):
            find()
    (here / "fleets").mkdir()
    (here / "fleets/sim.yaml").write_text("")
    assert find_file("fleets/sim.yaml", "fleet") == Path("fleets/sim.yaml")


def test_a_folder_of_that_name_is_no_file(here: Path) -> None:
    (here / "sim").mkdir()

    assert find_file("sim", "fleet") == bundled_path("fleets/sim.yaml")


@pytest.mark.parametrize("name", ["dancce", "dnace"])
def test_an_unknown_name_is_told_the_nearest(name: str) -> None:
    with pytest.raises(ConfigError, match=r"comes with the framework; did you mean 'dance'\?"):
        find_file(name, "scenario")


@pytest.mark.parametrize("name", ["..", "zz*"])
def test_an_unknown_name_is_told_what_there_is(name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        find_file(name, "scenario")

    (problem,) = caught.value.problems
    assert problem.file == name
    assert problem.message.startswith(
        "no such file, and no scenario of that name comes with the framework; there are: "
    )
    assert problem.message.endswith(", ".join(bundled_names("scenario")))


def test_whatever_reads_a_file_takes_a_name() -> None:
    assert EALConfigManager.load("sim").fleet.source == bundled_path("fleets/sim.yaml")
    assert load_scenario("dance").source == bundled_path("scenarios/dance.yaml")
    assert load_world("lab").name == "lab"
    with connect("roomba-1", fleet="sim") as one, connect("evbot2-1", fleet=bundled_path("fleets/sim.yaml")) as other:
        assert one._robot.name in other._owned_fleet  # type: ignore[operator]  # both share the fleet


def test_a_fleet_file_names_a_shipped_world_and_includes_a_shipped_fleet(here: Path) -> None:
    (here / "mine.yaml").write_text(FLEET.format(world="hall"))
    (here / "more.yaml").write_text("version: 1\ninclude: [sim]\nseed: 3\n")

    world = EALConfigManager.load("mine").fleet.world
    more = EALConfigManager.load("more").fleet

    assert world is not None
    assert world.name == "hall"
    assert (more.seed, "roomba-1" in more.robots) == (3, True)


def test_a_world_beside_the_fleet_file_goes_before_the_shipped_one(here: Path) -> None:
    folder = here / "site"
    folder.mkdir()
    (folder / "mine.yaml").write_text(FLEET.format(world="hall"))
    (folder / "hall.yaml").write_text("version: 1\nname: mine\nsize_m: [2, 2]\n")

    world = EALConfigManager.load("site/mine.yaml").fleet.world

    assert world is not None
    assert world.name == "mine"


def test_a_fleet_file_that_names_no_world_there_is_says_so(here: Path) -> None:
    (here / "mine.yaml").write_text(FLEET.format(world="hal"))

    with pytest.raises(ConfigError, match=r"mine.yaml:3:8: world: no such file, .*; did you mean 'hall'\?"):
        EALConfigManager.load("mine")


def test_files_that_are_confused_are_named() -> None:
    scenario, fleet = bundled_path("scenarios/dance.yaml"), bundled_path("fleets/sim.yaml")
    with pytest.raises(ConfigError, match=r"sim\.yaml:\d+:1: robots: this is a fleet file; a scenario file was exp"):
        load_scenario(fleet)
    Path("fleet.yaml").write_text(bundled_path("fleets/worlds/lab.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"fleet\.yaml:\d+:1: size_m: this is a world file; a fleet file was expected"
    ):
        EALConfigManager.load("fleet.yaml")
    with pytest.raises(
        ConfigError, match=r"dance\.yaml:\d+:1: steps: this is a scenario file; a world file was expect"
    ):
        load_world(scenario)
