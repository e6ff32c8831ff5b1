"""`eal new`: the files that it writes, checked and run."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.device.world import load_world
from eal_actors.managers.config import EALConfigManager
from tests.cli.conftest import Program


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("robot", "count"), [("roomba", 3), ("evbot2", 1), ("evbot3", 100)])
def test_a_new_fleet_has_the_robots_asked_for(eal: Program, robot: str, count: int) -> None:
    done = eal("new", "fleet", "mine.yaml", "--robot", robot, "--count", count)
    assert done.exit_code == 0, done.output
    assert eal("check", "mine.yaml").exit_code == 0
    fleet = EALConfigManager.load("mine.yaml").fleet
    assert (fleet.name, len(fleet.robots)) == ("mine", count)
    assert all(one.types == (robot,) for one in fleet.robots.values())


def test_new_files_run_together(eal: Program) -> None:
    assert eal("new", "world", "hall.yaml", "--size", "5x4", "--obstacles", 4).exit_code == 0
    assert eal("new", "fleet", "--robot", "roomba", "--count", 2).exit_code == 0
    text = Path("fleet.yaml").read_text(encoding="utf-8")
    Path("fleet.yaml").write_text(text.replace("world: lab", "world: hall.yaml"), encoding="utf-8")
    assert eal("new", "scenario", "--moves", "r10 l10", "--together").exit_code == 0
    done = eal("check", "scenario.yaml", "fleet.yaml", "hall.yaml")
    assert done.exit_code == 0, done.output
    done = eal("run", "scenario.yaml", "--fleet", "fleet.yaml", "--rate", "max", "--no-plot")
    assert done.exit_code == 0, done.output
    assert "2 robots, 6 calls" in done.output  # two moves and the stop each


@pytest.mark.parametrize("size", ["2x2", "6x4", "100x3.5"])
def test_a_new_world_holds_as_many_obstacles_as_it_says(eal: Program, size: str) -> None:
    done = eal("new", "world", "w.yaml", "--size", size, "--obstacles", 50)
    if done.exit_code:
        assert "has space for" in done.output
        room = done.output.split("has space for ")[1].split()[0]
        done = eal("new", "world", "w.yaml", "--size", size, "--obstacles", room)
    assert done.exit_code == 0, done.output
    assert load_world("w.yaml").places["home"].x_m == 0


@pytest.mark.parametrize("name", ["true", "null"])
def test_a_name_that_is_no_text_in_yaml_is_quoted(eal: Program, name: str) -> None:
    done = eal("new", "world", f"{name}.yaml", "--size", "6x4", "--obstacles", 1)
    assert done.exit_code == 0, done.output
    assert load_world(f"{name}.yaml").name == name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fleet", "--robot", "rooba"], "did you mean 'roomba'?"),
        (["fleet", "a b.yaml", "--robot", "roomba", "--count", "1"], "its name is the name inside"),
        (["fleet", "no/such/f.yaml", "--robot", "roomba", "--count", "1"], "cannot be written"),
        (["scenario", "--moves", "go, now"], "must be commands such as f0.5 l90"),
        (["world", "--size", "big"], "must be such as 6x4"),
        (["world", "--size", "1x1"], "from 2 to 100 m"),
    ],
)
def test_wrong_answers_write_nothing(eal: Program, here: Path, arguments: list[str], words: str) -> None:
    done = eal("new", *arguments)
    assert done.exit_code == 2
    assert words in " ".join(done.output.replace("│", " ").split())
    assert not list(here.iterdir())


def test_a_file_that_exists_stays(eal: Program) -> None:
    Path("fleet.yaml").write_text("mine", encoding="utf-8")
    done = eal("new", "fleet", "--robot", "roomba", "--count", 1)
    assert (done.exit_code, Path("fleet.yaml").read_text(encoding="utf-8")) == (2, "mine")


def test_a_person_is_asked_two_questions(here: Path) -> None:
    controller, terminal = pty.openpty()
    command = [sys.executable, "-m", "eal_actors", "new", "fleet"]
    asked = subprocess.Popen(command, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=here)
    os.close(terminal)
    os.write(controller, b"evbot3\n2\n")
    _, questions = asked.communicate(timeout=120)
    os.close(controller)
    assert asked.returncode == 0, questions
    assert b"Type of the robots (evbot2, evbot3, mavlink, roomba, ros2, vda5050) [evbot2]:" in questions
    assert b"How many robots [3]:" in questions
    assert len(EALConfigManager.load(here / "fleet.yaml").fleet.robots) == 2
