"""The thesis's own programs, unchanged, with robots in processes of their own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade import connections
from eal_actors.kernel.bundled import bundled_path
from scenarios.classic import camera, dance, square
from tests.net.links import free_port
from tests.net.rig import Servers, becomes, serving

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


@pytest.fixture
def fleet(running: Servers, fleet_file: Path) -> Iterator[Fleet]:
    """The fleet that the programs share with their test."""
    opened = connections.acquire_fleet(fleet_file)
    yield opened
    connections.release_fleet(opened)


def poses(fleet: Fleet) -> dict[str, tuple[float, ...]]:
    """Return the poses that the robots report."""
    ready = {name: robot for name, robot in fleet.items() if robot.state is RobotState.READY}
    return {name: tuple(map(float, robot["TruePose"].get_value().get().value)) for name, robot in ready.items()}


def test_square(fleet: Fleet) -> None:
    before = poses(fleet)
    assert square.main(["square.py", "roomba-1"]) == 0
    after = poses(fleet)
    assert 0 < math.dist(before["roomba-1"][:2], after["roomba-1"][:2]) < 0.3
    assert {name: before[name] for name in ROBOTS[:2]} == {name: after[name] for name in ROBOTS[:2]}


@pytest.mark.slow
def test_camera(fleet: Fleet, tmp_path: Path) -> None:
    assert camera.main(["camera.py", "evbot2-1", "50000", str(tmp_path)]) == 0
    pictures = sorted(tmp_path.glob("frame.*"))
    assert len(pictures) == 7
    assert len({picture.read_bytes() for picture in pictures}) == 7  # it turned between them


def test_dance_first_with_all_robots_then_without_one(fleet: Fleet, running: Servers) -> None:
    before = poses(fleet)
    assert dance.main(["dance.py", *ROBOTS]) == 0
    after = poses(fleet)
    right_deg = 45 - 90 + 90 - 10 + 10 - 10 + 360
    for name in ROBOTS:
        turned = (before[name][2] - after[name][2] - math.radians(right_deg) + math.pi) % (2 * math.pi) - math.pi
        assert abs(turned) < math.radians(45), name
    running["evbot3-1"].kill()
    assert becomes(fleet["evbot3-1"], RobotState.LOST)
    assert dance.main(["dance.py", *ROBOTS]) == 1
    last = poses(fleet)
    assert sorted(last) == ["evbot2-1", "roomba-1"]
    assert all(last[name] != after[name] for name in last)
