"""At `rate: max` a run repeats to the last bit: events, paths and saved values, in any process."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.managers.config import EALConfigManager
from eal_actors.recording.mcap_file import read_mcap

ROOT = Path(__file__).parents[2]
LIMIT_S = 120.0
UNLIKE = {"summary.json", "trajectory.png"}
"""Files with wall times, or with the version of the library that drew them."""


def traces_of(scenario: str, directory: Path, hash_seed: int, *options: str) -> dict[str, str]:
    """Run a scenario in a process of its own; return the hash of each file it left behind."""
    command = [sys.executable, "-m", "eal_actors", "run", str(ROOT / "scenarios" / scenario)]
    command += ["--fleet", str(ROOT / "fleets/sim.yaml"), "--rate", "max", "--no-plot", "--runs-dir", str(directory)]
    environment = {**os.environ, "PYTHONHASHSEED": str(hash_seed)}
    done = subprocess.run(
        [*command, *options], env=environment, timeout=LIMIT_S, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (run,) = directory.iterdir()
    return {
        str(file.relative_to(run)): hashlib.sha256(content_of(file)).hexdigest()
        for file in sorted(run.rglob("*"))
        if file.is_file() and file.name not in UNLIKE
    }


def content_of(file: Path) -> bytes:
    """Return the bytes of a file; of a record, whose times are of the wall clock, the messages by the fleet's clock."""
    return repr(read_mcap(file).messages).encode() if file.suffix == ".mcap" else file.read_bytes()


@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param("dance.yaml", marks=pytest.mark.slow),
        "square.yaml",
        pytest.param("panorama.yaml", marks=pytest.mark.slow),
    ],
)
def test_two_processes_write_the_same_files(scenario: str, tmp_path: Path) -> None:
    first = traces_of(scenario, tmp_path / "first", 1)
    assert {"events.jsonl", "trajectory.csv"} <= set(first)
    assert first == traces_of(scenario, tmp_path / "second", 2)


def test_another_seed_writes_other_files(tmp_path: Path) -> None:
    first = traces_of("square.yaml", tmp_path / "first", 1)
    other = traces_of("square.yaml", tmp_path / "other", 1, "--seed", "8")
    assert first["trajectory.csv"] != other["trajectory.csv"]


@pytest.mark.slow
def test_tasks_repeat_too(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    text = (ROOT / "fleets/sim.yaml").read_text().replace("worlds/empty.yaml", str(ROOT / "fleets/worlds/empty.yaml"))
    fleet.write_text(text.replace("rate: 2", "rate: max"))
    command = [sys.executable, str(ROOT / "scenarios/wander.py"), "--fleet", str(fleet), "--seconds", "60"]
    said = {
        subprocess.run(
            command,
            env={**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(ROOT)},
            timeout=LIMIT_S,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for hash_seed in ("1", "2", "3")
    }
    assert len(said) == 1


def test_a_program_that_polls_misses_no_deadline_of_its_calls() -> None:
    config = EALConfigManager.load(ROOT / "fleets/sim.yaml").fleet
    with Fleet(replace(config, rate="max")).connect(["evbot2-1"]) as fleet:
        robot, polls = fleet["evbot2-1"], 0
        drive = robot["Base"].send_cmd("f0.1")
        while not drive.done():
            robot["Pose"].get_value().get()
        assert drive.get() == 1
        end_s = fleet.clock.now() + 1.0
        while fleet.clock.now() < end_s:  # nothing moves: the next thing to happen is the deadline of the call
            robot["Pose"].get_value(timeout_s=0.5).get()
            polls += 1
    assert polls > 500
