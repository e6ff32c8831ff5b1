"""The thesis's own programs, unchanged, against robots that are served by processes of their own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.bundled import bundled_path
from eal_actors.facade import shared
from scenarios.classic import camera, dance, square
from tests.net.links import free_port
from tests.net.rig import Servers, serving

ROBOTS = ("evbot2-1", "evbot3-1", "roomba-1")


@pytest.fixture
def fleet_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The simulated fleet at ports of its own, faster than its file says."""
    addresses = "".join(f'  {name}: {{address: "tcp/127.0.0.1:{free_port()}"}}\n' for name in ROBOTS)
    file = tmp_path / "far.yaml"
    file.write_text(
        f"version: 1\ninclude: ['{bundled_path('fleets/sim.yaml')}']\nclock: {{rate: 40}}\n"
        f"defaults: {{timeout_s: 10000}}\nrobots:\n{addresses}",
        encoding="utf-8",
    )
    monkeypatch.setenv("EAL_FLEET", str(file))
    return file


@pytest.fixture
def running(fleet_file: Path) -> Iterator[Servers]:
    with serving(fleet_file, *ROBOTS) as servers:
        yield servers


def poses(fleet_file: Path) -> dict[str, tuple[float, ...]]:
    """Return where the robots say that they are."""
    fleet = shared.acquire_fleet(fleet_file)
    try:
        return {name: tuple(map(float, robot["Pose"].get_value().get().value)) for name, robot in fleet.items()}
    finally:
        shared.release_fleet(fleet)


def test_square(running: Servers, fleet_file: Path) -> None:
    before = poses(fleet_file)
    assert square.main(["square.py", "roomba-1"]) == 0
    after = poses(fleet_file)
    assert 0 < math.dist(before["roomba-1"][:2], after["roomba-1"][:2]) < 0.3
    assert {name: before[name] for name in ROBOTS[:2]} == {name: after[name] for name in ROBOTS[:2]}


def test_camera(running: Servers, tmp_path: Path) -> None:
    assert camera.main(["camera.py", "evbot2-1", "50000", str(tmp_path)]) == 0
    pictures = sorted(tmp_path.glob("frame.*"))
    assert len(pictures) == 7
    assert len({picture.read_bytes() for picture in pictures}) == 7  # it turned between them


def test_dance(running: Servers, fleet_file: Path) -> None:
    before = poses(fleet_file)
    assert dance.main(["dance.py", *ROBOTS, "nobody"]) == 0
    after = poses(fleet_file)
    right_deg = 45 - 90 + 90 - 10 + 10 - 10 + 360
    for name in ROBOTS:
        turned = (before[name][2] - after[name][2] - math.radians(right_deg) + math.pi) % (2 * math.pi) - math.pi
        assert abs(turned) < math.radians(45), name


def test_dance_without_one_of_the_robots(running: Servers, fleet_file: Path) -> None:
    running["evbot3-1"].kill()
    before = poses_of(fleet_file, "roomba-1")
    assert dance.main(["dance.py", *ROBOTS]) == 0
    assert poses_of(fleet_file, "roomba-1") != before


def poses_of(fleet_file: Path, name: str) -> tuple[float, ...]:
    fleet = shared.acquire_fleet(fleet_file)
    try:
        return tuple(map(float, fleet[name]["Pose"].get_value().get().value))
    finally:
        shared.release_fleet(fleet)
