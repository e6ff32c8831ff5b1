"""A secured fleet is updated: one robot loses its power, one fails its check, and the next runs go on.

Each robot is a machine in a folder with processes of its own. `EVBOTOS_ROBOTS=10` (`make test-fleet-update`) makes it
ten.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests.evbotos.machine_rig import bundle, comes_true
from tests.evbotos.machines import BROKEN, FolderMachine, machines_of

ROBOTS = int(os.environ.get("EVBOTOS_ROBOTS", "3"))
OLD = random.Random(1).randbytes(8_000_000)  # noqa: S311  # contents of a root
NEW = OLD[:3_000_000] + random.Random(2).randbytes(3_000_000) + OLD[4_000_000:]  # noqa: S311

TURN = """version: 1
name: turn
roles: {drivers: {}}
steps:
  - {on: drivers, do: [{send_cmd: {resource: Base, cmd: r10}}]}
"""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


def words_of(folder: Path, *more: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "evbotos",
        "fleet",
        "update",
        str(folder / "fleet.yaml"),
        str(folder / "u.tar"),
        *more,
    ]


def update(folder: Path, *more: str) -> str:
    """Run the command, and return what it said, whether it failed or not."""
    done = subprocess.run(
        words_of(folder, *more), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder, check=False
    )
    return done.stdout


def runs(machine: FolderMachine, root: bytes) -> bool:
    return machine.running_root()[: len(root)] == root


def test_a_fleet_is_updated_with_a_power_cut_and_a_failure(tmp_path: Path) -> None:
    names = [f"r{number}" for number in range(1, ROBOTS + 1)]
    first, cut, ill = names[0], names[1], names[-1]
    (tmp_path / "u.tar").write_bytes(bundle(root=NEW))
    (tmp_path / "turn.yaml").write_text(TURN)
    absent = {ill: "serial_port: {port: /dev/ttyS99}"}
    with machines_of(tmp_path, names, absent, OLD) as fleet:
        fleet[cut].lose_power_after(2_000_000)  # of three million bytes that are new
        said = update(tmp_path).splitlines()
        assert said[-1] == f"{ROBOTS - 2} updated; 1 absent ({cut}); 1 failed ({ill})", said
        assert all(runs(fleet[name], NEW) for name in names if name not in (cut, ill))
        assert runs(fleet[ill], OLD), said  # it came up, but not all of its resources are ready: it returned

        assert runs(fleet[cut], OLD)
        fleet[cut].cut_power()
        fleet[cut].boot()
        assert comes_true(fleet[cut].is_up)
        again = update(tmp_path, "--robot", first, "--robot", cut, "--check", str(tmp_path / "turn.yaml"))
        assert again.endswith("2 updated\n"), again
        assert f"{first}: receives" not in again
        sent = next(line for line in again.splitlines() if line.startswith(f"{cut}: has received"))
        assert sent.endswith(" of 10.0 MB were sent")
        assert float(sent.split()[-6]) < 2.5, sent  # the pieces that the power cut left are not sent again
        assert runs(fleet[cut], NEW)


def test_a_system_that_does_not_come_up_stops_the_fleet(tmp_path: Path) -> None:
    (tmp_path / "u.tar").write_bytes(bundle(root=BROKEN + NEW))
    with machines_of(tmp_path, ["ada", "bob"], {}, OLD) as fleet:
        said = update(tmp_path)
        assert "came back with 7.0.0.1700000000: the new system did not come up" in said, said
        assert "1 failed (ada); 1 not begun (bob)" in said
        assert all(runs(machine, OLD) for machine in fleet.values())
