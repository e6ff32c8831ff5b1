"""A secured fleet of booted machines is updated by the command: one loses its power, one is not healthy afterwards.

`EVBOTOS_ROBOTS=10` (`make test-fleet-of-machines`) makes it ten machines.
"""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos import verity
from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.hosttools import tool
from evbotos.identity import put_identity
from evbotos.model import Local
from evbotos.provision_command import provision_fleet
from evbotos.qemu import Machine
from evbotos.robot_files import access_files
from evbotos.shell import run as run_tool
from evbotos.update import write_update
from tests.evbotos.conftest import has_kernel
from tests.evbotos.proof import (
    SERVES,
    Proof,
    answer,
    eal,
    give_access,
    require_tools,
    started,
    wait_for_words,
)
from tests.evbotos.proofs import wait_for_good

ROBOTS = int(os.environ.get("EVBOTOS_ROBOTS", "3"))
NAMES = [f"r{number}" for number in range(1, ROBOTS + 1)]
CUT, ILL, LAST = NAMES[-3:]
ABSENT = re.compile(r"\d+ absent \(([^)]*)\)")
NEW_BYTES = 8_000_000
CUT_AT = 92
"""Percent of the update that the robot has when its power is cut; it has 84 from the start."""
_TIMEOUT_S = 3600.0
_TRIES = 10
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(4 * _TIMEOUT_S)]


@dataclass
class MachineFleet:
    """Booted robots.

    Attributes:
        proof: their image, and the controller's fleet file and keys.
        folder: of their disks and of the update.
        machines: those that run, by robot.
        has_lost_power: whether the power of one was cut.
    """

    proof: Proof
    folder: Path
    machines: dict[str, Machine] = field(default_factory=dict)
    has_lost_power: bool = False

    def boot(self, robot: str, stack: ExitStack) -> None:
        """Switch a machine on."""
        self.machines[robot] = stack.enter_context(started(self.proof, self.folder / f"{robot}.img"))

    def wait_until_good(self, robot: str, slot: str) -> None:
        """Wait until a machine serves from a slot, which is permanent."""
        wait_for_words(self.machines[robot], SERVES)
        wait_for_good(self.proof, self.machines[robot], slot)

    def has_new_system(self, robot: str) -> bool:
        """Return whether a machine runs the new root."""
        return answer(self.proof, self.machines[robot], "ls /ro").split().count("novelty") == 1

    def update(self, *more: str) -> subprocess.Popen[str]:
        """Start the command."""
        words = ["fleet", "update", str(self.proof.fleet), str(self.folder / "update.tar"), "--restart-s", "1200"]
        ports = {f"{robot.upper()}_PORT": str(machine.ports["eal"]) for robot, machine in self.machines.items()}
        return subprocess.Popen(
            [sys.executable, "-m", "evbotos", *words, "--check", "square", *more],
            env={**os.environ, **ports},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )


def fleet_text() -> str:
    """Return the fleet file: one robot has a serial port that no machine has."""
    lines = ["version: 1", "name: lab", "defaults: {timeout_s: 120}", "robots:"]
    for number, name in enumerate(NAMES, 1):
        more = ", serial_port: {port: /dev/ttyS99}" if name == ILL else ""
        lines += [
            f"  {name}:",
            f"    address: tls/127.0.0.1:${{{name.upper()}_PORT:-{50000 + number}}}",
            "    listen: tls/0.0.0.0:50000",
            f"    plugins: {{sim: {{model: evbot3}}, evbotos: {{}}{more}}}",
        ]
    lines += ["network:", "  lease_s: 60", "  dead_man_s: 60"]
    lines.append("  security: {keys: keys, controller: controller, roles: {controllers: [controller]}}")
    return "\n".join([*lines, ""])


def write_new_system(proof: Proof, folder: Path) -> None:
    """Write an update whose root has one file more than the running one, which does not compress."""
    novelty, squashed, built = folder / "novelty", folder / "squashed", folder / "built"
    novelty.mkdir()
    (novelty / "novelty").write_bytes(random.Random(1).randbytes(NEW_BYTES))  # noqa: S311  # contents of a file
    shutil.copyfile(proof.built.folder / "root.squashfs", squashed)
    run_tool([tool("mksquashfs"), novelty, squashed, "-no-progress", "-quiet"])
    verity.append_hashes(squashed, built)
    shutil.copyfile(proof.built.folder / "kernel", built / "kernel")
    report = {**proof.built.report, "verity": asdict(verity.read_verity(built))}
    (built / "manifest.json").write_text(json.dumps(report))
    write_update(built, proof.update_key, folder / "update.tar")


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[tuple[MachineFleet, ExitStack]]:
    """Machines with one image and an identity each, which all serve."""
    found = load_definitions()
    platform, image = found.platform("qemu-amd64"), found.image("robot")
    lock = found.lock_path(platform, image)
    require_tools(platform)
    if not has_kernel(platform, lock):
        pytest.skip("no kernel in the cache yet: `make test-evbotos`")
    file, access = tmp_path / "fleet.yaml", give_access(tmp_path)
    file.write_text(fleet_text())
    eal("keys", "init", "--fleet", file)
    eal("keys", "controller", "controller", "--fleet", file)
    built = Build(platform, image, Local(version=1), lock, _LOG.info).run(tmp_path / "out")
    proof = Proof(platform, image, built, file, tmp_path, tmp_path / "ssh", tmp_path / "update.pem")
    machines = MachineFleet(proof, tmp_path)
    write_new_system(proof, tmp_path)
    with ExitStack() as stack:
        for name, identity in provision_fleet(file, None, access_files(access), tmp_path / "identities").items():
            disk = Path(shutil.copyfile(built.folder / "disk.img", tmp_path / f"{name}.img"))
            put_identity(identity, disk)
            machines.boot(name, stack)
        for name in NAMES:
            machines.wait_until_good(name, "a")
        yield machines, stack


def update_reached(machines: MachineFleet, expected: int, *more: str) -> list[str]:
    """Return what the command said; the power of one robot is cut in the middle of its first update.

    It runs again if a busy computer's emulators did not answer in time: robots that were updated already stay so.
    """
    for _ in range(_TRIES):
        lines = []
        with machines.update(*more) as command:
            assert command.stdout is not None
            for line in map(str.rstrip, command.stdout):
                _LOG.warning(line)
                lines.append(line)
                percent = re.fullmatch(rf"{CUT}: receives .*: (\d+)%", line)
                if percent is not None and int(percent[1]) >= CUT_AT and not machines.has_lost_power:
                    machines.machines[CUT].kill()
                    machines.has_lost_power = True
        found = ABSENT.search("\n".join(lines))
        absent = set(found[1].split(", ")) if found is not None else set()
        if absent <= {robot for robot, machine in machines.machines.items() if not machine.is_running()}:
            break
    assert command.returncode == expected, lines
    return lines


def test_booted_robots_are_updated_with_a_power_cut_and_a_failure(fleet: tuple[MachineFleet, ExitStack]) -> None:
    machines, stack = fleet
    lines = update_reached(machines, 1)
    assert f"{CUT}: went away; what has arrived stays" in lines
    updated = f"{ROBOTS - 3} updated; " if ROBOTS > 3 else ""
    assert lines[-1] == f"{updated}1 absent ({CUT}); 1 failed ({ILL}); 1 not begun ({LAST})", lines
    assert any(line.startswith(f"{ILL}: is not healthy: SerialPort") for line in lines), lines
    for name in NAMES:
        if name != CUT:
            assert machines.has_new_system(name) == (name not in (ILL, LAST)), name

    machines.boot(CUT, stack)
    machines.wait_until_good(CUT, "a")
    assert not machines.has_new_system(CUT)
    lines = update_reached(machines, 0, "--robot", CUT)
    assert lines[-1] == "1 updated", lines
    sent = next(line for line in lines if line.startswith(f"{CUT}: has received"))
    assert float(sent.split()[-6]) < NEW_BYTES / 1e6 * 0.8, sent  # what arrived before the cut is not sent again
    assert machines.has_new_system(CUT)
    lines = update_reached(machines, 0, "--robot", CUT)
    assert lines[-1] == "1 updated", lines
    assert not any("receives" in line for line in lines), lines
