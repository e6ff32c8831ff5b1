"""`eal map`: of worlds, of map files, and of the scans of a run."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eal_actors.device.navigation.map_file import load_map
from eal_actors.device.navigation.world_grid import grid_from_world
from eal_actors.device.world import load_world
from tests.scenario_texts import scenario_of

HALL = """\
version: 1
name: hall
size_m: [6, 4]
obstacles:
  - {kind: wall, start_m: [0, -2], end_m: [0, 1.2]}
places: {dock: {x_m: 2.5, y_m: -1.5, yaw_deg: 90}, door: {x_m: -2.5, y_m: -1.5}}
keep_out: [[[-2.5, 0], [-1.5, 0], [-2, 1]]]
"""
SCANNING = """\
version: 1
name: scanning
seed: 3
clock: {rate: max}
world: lab
robots:
  scout:
    plugins: {sim: {model: evbot3, start: {x_m: 0.3, y_m: 0.2, yaw_deg: 0}, lidar: {rays: 180, max_range_m: 6}}}
"""


def error_of(result: Any) -> str:
    """Return the message of an error, which is JSON on stdout with `--json`."""
    return " ".join((result.stdout + result.stderr).replace("│", " ").split())


def test_a_path_between_places(eal: Any, write: Any) -> None:
    result = eal("map", write("hall.yaml", HALL), "--plan", "door", "dock", "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    shown = json.loads(result.stdout)
    points = shown["path"]["points_m"]
    assert (points[0], points[-1]) == ([-2.5, -1.5], [2.5, -1.5])
    around_the_wall = 2 * math.hypot(2.5, 2.7)
    assert around_the_wall <= shown["path"]["length_m"] <= around_the_wall + 0.6
    assert (shown["rows"], shown["columns"], shown["resolution_m"]) == (80, 120, 0.05)
    assert shown["cells"]["unknown"] == 0
    assert shown["places"]["dock"] == {"x_m": 2.5, "y_m": -1.5, "yaw_deg": 90.0}


def test_a_path_keeps_the_robots_own_radius(eal: Any, write: Any) -> None:
    """Between the wall and the room's are 0.6 m, of which an EvBot III of 0.2 m leaves 0.1 m, and a Roomba more."""
    world = write("hall.yaml", HALL)
    models = {"small": "roomba", "large": "evbot3"}
    robots = "".join(f"  {name}: {{plugins: {{sim: {{model: {model}}}}}}}\n" for name, model in models.items())
    fleet = write("fleet.yaml", f"version: 1\nname: two\nrobots:\n{robots}")
    plan = ("map", world, "--plan", "door", "dock", "--json")
    lengths_m = {
        robot: json.loads(eal(*plan, "--fleet", fleet, "--robot", robot).stdout)["path"]["length_m"]
        for robot in ("small", "large")
    }
    for robot, radius_m in (("small", 0.17), ("large", 0.20)):
        alone = json.loads(eal(*plan, "--radius-m", radius_m + 0.05).stdout)["path"]["length_m"]
        assert lengths_m[robot] == alone
    assert lengths_m["small"] < lengths_m["large"]
    assert "needs --fleet, and no --radius-m" in error_of(eal(*plan, "--robot", "small", "--radius-m", 1))
    assert "nobody" in error_of(eal(*plan, "--fleet", fleet, "--robot", "nobody"))


@pytest.mark.parametrize("name", ["plan.png", "plan.svg"])
def test_a_map_is_drawn(eal: Any, write: Any, tmp_path: Path, name: str) -> None:
    picture = tmp_path / name
    result = eal("map", write("hall.yaml", HALL), "--plan", "door", "1,-1", "--radius-m", 0.3, "--save", picture)
    assert result.exit_code == 0
    lines = result.stdout.replace("\n", " ")
    assert picture.name in lines
    assert "door to 1,-1: " in lines
    content = picture.read_bytes()
    assert content.startswith(b"\x89PNG" if name.endswith("png") else b"<?xml")


def test_a_world_becomes_a_map_file_that_is_a_map_again(eal: Any, write: Any, tmp_path: Path) -> None:
    file = tmp_path / "floor.yaml"
    assert eal("map", write("hall.yaml", HALL), "--save", file).exit_code == 0
    assert load_map(file).cells.tolist() == grid_from_world(load_world(tmp_path / "hall.yaml")).cells.tolist()
    result = eal("map", file, "--plan", "-2.5,-1.5", "2.5,-1.5", "--json")
    assert json.loads(result.stdout)["path"]["length_m"] > 7
    assert "a map file has none; write x,y in metres: 1.5,-2" in error_of(eal("map", file, "--plan", "dok", "1,1"))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("--plan", "door", "dok"), 2, "unknown place 'dok'; did you mean 'dock'? Places of 'hall': dock, door"),
        (("--plan", "door", "1;2"), 2, "unknown place '1;2'."),
        (("--plan", "door", "1,x"), 2, "'1,x' is no point; write x,y in metres: 1.5,-2"),
        (("--plan", "door", "9,0"), 1, "the goal (9, 0) is outside the map, which reaches from -3 to 3 m in x and"),
        (("--plan", "door", "0,0"), 1, "the goal (0, 0) is inside an obstacle; the nearest free position is ("),
        (("--plan", "door", "-2,0.4"), 1, "the goal (-2, 0.4) is inside an obstacle"),
        (("--plan", "door", "dock", "--radius-m", "0.45"), 1, "no path leads from (-2.5, -1.5) to (2.5, -1.5)"),
        (("--resolution-m", "0"), 2, "0"),
        (("--save", "map.gif"), 2, "'map.gif' must end in .pdf, .png, .svg, .yaml, .yml"),
        (("--save", "nowhere/map.png"), 2, "nowhere/map.png: cannot be written: No such file or directory"),
    ],
)
def test_errors_are_clear(eal: Any, write: Any, arguments: tuple[str, ...], code: int, message: str) -> None:
    result = eal("map", write("hall.yaml", HALL), *arguments)
    assert result.exit_code == code
    assert message in error_of(result)


def test_a_run_gives_the_map_of_its_scans(eal: Any, write: Any, tmp_path: Path) -> None:
    steps = [f"send_cmd: {{resource: Base, cmd: {command}}}" for command in ("f0.8", "l90", "f0.8", "l90", "f0.8")]
    scenario = write("look.yaml", scenario_of(*steps, name="look"))
    runs = tmp_path / "runs"
    fleet = write("fleet.yaml", SCANNING)
    assert eal("run", scenario, "--fleet", fleet, "--runs-dir", runs, "--record", "sensors").exit_code == 0
    (run,) = runs.iterdir()
    file = tmp_path / "floor.yaml"
    assert eal("map", run, "--save", file).exit_code == 0
    found, world = load_map(file), grid_from_world(load_world("lab"))
    free = found.centres(np.argwhere(found.cells == 0))
    assert len(free) > 0.7 * (world.cells == 0).sum()  # the rest is hidden
    assert world.are_free(free).mean() > 0.99
    walls = found.centres(np.argwhere(found.cells == 100))
    assert len(walls) > 500
    assert world.inflated(0.05).are_free(walls).mean() < 0.01


def test_a_run_without_scans_says_so(eal: Any, write: Any, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    fleet, scenario = write("fleet.yaml", SCANNING), write("s.yaml", scenario_of("send_cmd: {resource: Base, cmd: s}"))
    assert eal("run", scenario, "--fleet", fleet, "--runs-dir", runs).exit_code == 0
    (run,) = runs.iterdir()
    result = eal("map", run, "--save", tmp_path / "m.png")
    assert result.exit_code == 2
    assert "a map of scans has no scan yet; recorded: no scanner; record one, such as a `Lidar`" in error_of(result)
    (run / "run.mcap").unlink()
    assert "has no run.mcap; `eal run` writes it" in error_of(eal("map", run))
    assert "it has no events.jsonl" in error_of(eal("map", tmp_path))
