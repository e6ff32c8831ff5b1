"""`eal world`."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from eal_actors.cli.exit_codes import TROUBLESHOOTING
from eal_actors.cli.world import summarize_world
from eal_actors.device.world import load_world
from eal_actors.kernel.bundled import bundled_path

LAB = bundled_path("fleets/worlds/lab.yaml")

HALL = """\
version: 1
name: hall
size_m: [6, 4]
obstacles:
  - {kind: wall, start_m: [0, 0], end_m: [0, 1.5]}
  - {kind: circle, x_m: 1, y_m: -1, radius_m: 0.25}
boxes: [{name: crate, x_m: -1, y_m: -1}, {name: chest, x_m: -2, y_m: -1, yaw_deg: 30}]
drops: [{x_m: 2, y_m: 1, size_m: [0.5, 1]}]
places: {dock: {x_m: 2.5, y_m: -1.5, yaw_deg: 90}, door: {x_m: -2.5, y_m: 1.5}}
keep_out: [[[-3, 0], [-2, 0], [-2.5, 1]]]
starts: {shape: wedge, count: 3, spacing_m: 0.5, x_m: -2}
"""


def test_it_shows_what_is_where(eal: Any, write: Any) -> None:
    result = eal("world", write("hall.yaml", HALL))
    assert (result.exit_code, result.stderr) == (0, "")
    heading, *rows = [" ".join(line.split()) for line in result.stdout.splitlines() if line.strip()]
    contents = "2 obstacles, 2 boxes, 1 drop, 1 keep-out zone, 2 places, 3 start poses"
    assert heading == f"hall 6 x 4 m, {contents}; 2.5 m high, 150 lux, 50 Hz"
    assert rows[2:] == [
        "obstacles[0] 0 0.75 90 wall, 1.5 x 0.1 m, 0.8 m high",
        "obstacles[1] 1 -1 circle, 0.5 m across, 0.8 m high",
        "boxes[0] -1 -1 0 crate, 0.3 x 0.3 m, 0.3 m high, 1 kg",
        "boxes[1] -2 -1 30 chest, 0.3 x 0.3 m, 0.3 m high, 1 kg",
        "drops[0] 2 1 0 0.5 x 1 m",
        "keep_out[0] (-3, 0), (-2, 0), (-2.5, 1)",
        "places.dock 2.5 -1.5 90",
        "places.door -2.5 1.5",
        "starts -2 0 0 wedge of 3, 0.5 m apart",
    ]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("empty", "6 x 4 m, empty"),
        ("lab", "8 x 6 m, 5 obstacles, 1 box, 1 beacon, 8 posters, 2 lamps, 3 places"),
        ("field", "24 x 24 m, 6 obstacles, 4 beacons, 100 start poses"),
    ],
)
def test_contents_in_few_words(name: str, expected: str) -> None:
    assert summarize_world(load_world(bundled_path(f"fleets/worlds/{name}.yaml"))) == expected


def test_json_has_every_default_and_every_pose(eal: Any, write: Any) -> None:
    shown = json.loads(eal("world", write("hall.yaml", HALL), "--json").stdout)
    assert shown["starts"]["shape"] == "wedge"
    assert [pose["y_m"] for pose in shown["start_poses"]] == pytest.approx([0, 0.353553, -0.353553])
    assert shown["lighting"] == {"ambient_lux": 150.0, "lamps": []}


@pytest.mark.parametrize(("name", "magic"), [("lab.png", b"\x89PNG"), ("lab.svg", b"<?xml"), ("lab.pdf", b"%PDF")])
def test_its_plan_is_drawn(eal: Any, tmp_path: Path, name: str, magic: bytes) -> None:
    picture = tmp_path / name
    result = eal("world", LAB, "--save", picture)
    assert (result.exit_code, result.stdout, result.stderr) == (0, f"{picture}\n", "")
    assert picture.read_bytes().startswith(magic)


@pytest.mark.parametrize(
    ("name", "words"),
    [("lab.gif", "must end in .pdf, .png, .svg"), ("nowhere/lab.png", "cannot be written: No such file or directory")],
)
def test_a_picture_that_cannot_be_written_is_bad_input(eal: Any, tmp_path: Path, name: str, words: str) -> None:
    result = eal("world", LAB, "--save", tmp_path / name)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_there_is_no_picture(eal: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = eal("world", LAB, "--save", tmp_path / "lab.png")
    assert result.exit_code == 1
    assert "matplotlib is missing" in result.stderr


def test_a_bad_world_is_told_with_its_places(eal: Any, write: Any) -> None:
    file = write("w.yaml", "version: 1\nname: w\nsize_m: [2, 2]\nstarts: [{x_m: 3, y_m: 0}]\n")
    result = eal("world", file)
    assert result.exit_code == 2
    assert result.stderr.splitlines() == [
        f"{file}:4:10: starts[0]: it is outside the room, which reaches from -1 to 1 m in x and from -1 to 1 m in y",
        "    starts: [{x_m: 3, y_m: 0}]",
        "             ^",
        "1 problem; nothing was done.",
        f"config: {TROUBLESHOOTING}#config",
    ]
