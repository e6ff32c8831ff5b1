"""`eal replay`: a fleet file that stands for the run's own, and the command that uses it."""

from __future__ import annotations

import os
import pty
import re
import shlex
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from tests.net.links import free_port
from tests.program import eal_processes
from tests.scenario_texts import scenario_of


def test_the_command_that_it_names_runs_the_scenario_again_on_the_record(eal: Any, write: Any, tmp_path: Path) -> None:
    steps = ("send_cmd: {resource: Base, cmd: 'f${way_m}'}", "get_value: {resource: Odometry}")
    roles = "roles: {small: {types: [evbot3]}, vacuums: {tags: [vacuum]}}\nparameters: {way_m: {type: double}}"
    text = scenario_of(*steps, name="short", role="small").replace("roles: {small: {}}", roles)
    runs, scenario = tmp_path / "runs", write("short.yaml", text)
    fleet = ("--fleet", bundled_path("fleets/sim.yaml"), "--rate", "max")
    assert eal("run", scenario, *fleet, "--set", "way_m=0.1", "--runs-dir", runs, "--no-plot").exit_code == 0
    (run,) = runs.iterdir()

    told = eal("replay", run, "--out", tmp_path / "played.yaml").stdout
    assert "2 robots" in told
    played = EALConfigManager.load(tmp_path / "played.yaml").fleet
    assert (played.rate, played.seed) == ("max", 7)
    robot = played.robots["roomba-1"]
    assert (robot.types, robot.tags) == (("roomba",), ("wheeled", "vacuum", "indoor"))

    command = shlex.split(" ".join(told.replace("\n", " ").partition("next: ")[2].split()))
    assert command[0] == "eal"
    again = eal(*command[1:], "--runs-dir", tmp_path / "again", "--no-plot")
    assert again.exit_code == 0, again.output
    assert "send_cmd Base f0.1  done after" in again.stdout


def test_python_steps_beside_the_fleet_file_work_on_the_record(
    eal: Any, write: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write("greetings.py", "def greet(context):\n    context.log('hello')\n")
    write("fleet.yaml", "version: 1\ninclude: [sim]\nclock: {rate: max}\npython_steps: ['greetings:greet']\n")
    scenario = write("short.yaml", scenario_of("python: greetings:greet", role="all"))
    assert eal("run", scenario, "--fleet", "fleet.yaml", "--no-plot").exit_code == 0
    (run,) = Path("runs").iterdir()
    told = eal("replay", run).stdout
    first, following = (shlex.split(line.partition(": ")[2]) for line in told.splitlines()[1:])
    subprocess.run(first, check=True)
    again = eal(*following[1:], "--no-plot")
    assert again.exit_code == 0, again.output
    assert "hello" in again.stdout


def test_a_run_with_planned_paths_names_no_command_that_would_be_refused(eal: Any, write: Any, tmp_path: Path) -> None:
    text = scenario_of("visit: [[1.5, 0.2]]", role="mover").replace("mover: {}", "mover: {robots: [roomba-1]}")
    scenario = write("short.yaml", text)
    fleet = ("--fleet", bundled_path("fleets/sim.yaml"), "--rate", "max")
    assert eal("run", scenario, *fleet, "--runs-dir", tmp_path / "runs", "--no-plot").exit_code == 0
    (run,) = (tmp_path / "runs").iterdir()
    told = eal("replay", run).stdout
    assert "the paths of its visit are not in a record" in " ".join(told.split())
    assert "next" not in told


def test_the_rate_can_be_chosen(eal: Any, write: Any, tmp_path: Path) -> None:
    scenario = write("short.yaml", scenario_of("log: x", role="all"))
    fleet = ("--fleet", bundled_path("fleets/sim.yaml"), "--rate", "3")
    assert eal("run", scenario, *fleet, "--runs-dir", tmp_path / "runs", "--no-plot").exit_code == 0
    (run,) = (tmp_path / "runs").iterdir()
    for options, rate in (((), 3.0), (("--rate", "0.5"), 0.5), (("--rate", "max"), "max")):
        assert eal("replay", run, *options).exit_code == 0
        assert EALConfigManager.load(run / "replay.yaml").fleet.rate == rate
    assert eal("replay", run, "--rate", "0").exit_code == 2
    assert "not possible with --serve" in eal("replay", run, "--rate", "max", "--serve").output.replace("\n", " ")


def test_a_served_replay_says_where_it_is(start: Any, eal: Any, write: Any, tmp_path: Path) -> None:
    scenario = write("short.yaml", scenario_of("send_cmd: {resource: Base, cmd: f0.2}", role="all"))
    fleet = write("f.yaml", "version: 1\nrobots: {one: {plugins: {sim: {model: roomba}}}}\n")
    done = eal("run", scenario, "--fleet", fleet, "--rate", "max", "--runs-dir", tmp_path / "runs", "--no-plot")
    assert done.exit_code == 0, done.output
    (run,) = (tmp_path / "runs").iterdir()
    process = start("replay", run, "--serve", "--rate", 5, "--port", free_port())
    lines = iter(process.stdout.readline, "")
    assert any(line.startswith("one: tcp/") for line in lines)
    ended = next(lines)
    length = re.match(r"the record ended at ([\d.]+) s", ended)
    assert length is not None, ended
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert f"replayed {length[1]} of {length[1]} s, served for " in out


@pytest.mark.slow
def test_at_a_terminal_it_opens_the_page_with_the_player(eal: Any, write: Any, tmp_path: Path) -> None:
    scenario = write("short.yaml", scenario_of("log: x", role="all"))
    fleet = ("--fleet", bundled_path("fleets/sim.yaml"), "--rate", "max")
    assert eal("run", scenario, *fleet, "--runs-dir", tmp_path / "runs", "--no-plot").exit_code == 0
    (run,) = (tmp_path / "runs").iterdir()
    opened = tmp_path / "opened"
    os.mkfifo(opened)
    browser = tmp_path / "bin" / "xdg-open"
    browser.parent.mkdir()
    browser.write_text(f'#!/bin/sh\necho "$1" > {opened}\n')
    browser.chmod(0o755)
    ours, theirs = pty.openpty()
    environment = {**os.environ, "PATH": f"{browser.parent}:{os.environ['PATH']}"}
    with eal_processes(tmp_path) as start:
        process = start("replay", run, environment=environment, stdout=theirs)
        assert opened.read_text().strip() == str(run / "report.html")
        assert process.wait(60) == 0
    os.close(theirs)
    os.close(ours)
    assert 'id="player-data"' in (run / "report.html").read_text(encoding="utf-8")
    assert (run / "replay.yaml").exists()
