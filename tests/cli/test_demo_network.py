"""`make demo-network`, in a shorter form."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from tests.net.links import free_port

Start = Callable[..., Any]


@pytest.fixture
def served_slides(slides: Path) -> Path:
    """Two slides that need servers."""
    text = slides.read_text(encoding="utf-8")
    for name in ("one", "two"):
        text = text.replace(f"  {name}: {{", f"  {name}: {{address: 'tcp/127.0.0.1:{free_port()}', ")
    slides.write_text(text, encoding="utf-8")
    return slides


def test_servers_are_started_the_scenario_runs_and_they_are_stopped(
    start: Start, served_slides: Path, move: Path, tmp_path: Path
) -> None:
    process = start("demo-network", move, "--fleet", served_slides, "--runs-dir", tmp_path / "runs")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, out + err
    (run,) = (tmp_path / "runs").iterdir()
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    assert (summary["outcome"], sorted(summary["robots"])) == ("done", ["one", "two"])
    assert [line.split(" at ")[0] for line in err.splitlines()] == ["one: listening", "two: listening"]
    for robot in EALConfigManager.load(served_slides).fleet.robots.values():
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", int(str(robot.address).rpartition(":")[2])))


@pytest.mark.slow
def test_a_robot_whose_port_is_taken_gets_a_free_one(
    start: Start, served_slides: Path, move: Path, tmp_path: Path
) -> None:
    address = str(EALConfigManager.load(served_slides).fleet.robots["two"].address)
    with socket.socket() as other:
        other.bind(("127.0.0.1", int(address.rpartition(":")[2])))
        other.listen()
        process = start("demo-network", move, "--fleet", served_slides, "--runs-dir", tmp_path / "runs")
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, out + err
    assert f"two: port {address.rpartition(':')[2]} is in use by another program" in err
    (run,) = (tmp_path / "runs").iterdir()
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    assert (summary["outcome"], sorted(summary["robots"])) == ("done", ["one", "two"])


@pytest.mark.slow
def test_two_demos_at_once_move_their_own_robots(start: Start, served_slides: Path, move: Path, tmp_path: Path) -> None:
    """Both have the same robots and the same ports; the slower one moves to others."""
    runs = [tmp_path / name for name in ("a", "b")]
    demos = [start("demo-network", move, "--fleet", served_slides, "--runs-dir", folder) for folder in runs]
    for demo, folder in zip(demos, runs, strict=True):
        out, err = demo.communicate(timeout=120)
        if demo.returncode == 3:  # both looked at the ports at the same moment: said, and nothing moved
            assert "the port is in use by " in err
            assert not folder.exists()
        else:
            assert demo.returncode == 0, out + err
            (run,) = folder.iterdir()
            assert json.loads((run / "summary.json").read_text(encoding="utf-8"))["outcome"] == "done"
    assert 0 in {demo.returncode for demo in demos}


def test_the_demo_is_the_dance_of_three_robots_with_ports_of_their_own() -> None:
    fleet = EALConfigManager.load(bundled_path("fleets/loopback.yaml")).fleet
    assert {robot.name: robot.address for robot in fleet.robots.values()} == {
        "evbot2-1": "tcp/127.0.0.1:50001",
        "evbot3-1": "tcp/127.0.0.1:50002",
        "roomba-1": "tcp/127.0.0.1:50003",
    }
