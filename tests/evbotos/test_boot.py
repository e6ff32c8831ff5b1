"""The proof: an image is built, started in QEMU, and the robot inside drives the square for a controller outside."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.clock import REAL_TIME
from eal_actors.errors import EALError
from eal_actors.log import get_logger
from evbotos.build import Build, Built, has_kernel
from evbotos.definitions import load_definitions
from evbotos.hosttools import find_tool, needed_for
from evbotos.model import Local, Platform
from evbotos.qemu import Machine, running

PLATFORM = "qemu-amd64"
ROBOT = "evbot"
FLEET = """version: 1
name: proof
defaults: {timeout_s: 120}  # an emulator on a busy machine is slow
robots:
  evbot:
    plugins: {sim: {model: evbot3}}
    address: tls/127.0.0.1:${EVBOT_PORT:-50000}
    listen: tls/0.0.0.0:50000
network:
  lease_s: 60
  dead_man_s: 60
  security: {keys: keys, controller: controller, roles: {controllers: [controller]}}
"""
LONGEST_BOOT_S = 240.0

_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(900)]


@dataclass(frozen=True)
class Proof:
    """What the tests start.

    Attributes:
        platform: the board.
        built: the robot image.
        fleet: the controller's fleet file, with its keys.
        ssh_key: private key that may log in.
    """

    platform: Platform
    built: Built
    fleet: Path
    ssh_key: Path


def run(*argv: str | Path, **env: str) -> str:
    done = subprocess.run(
        [str(part) for part in argv], env={**os.environ, **env}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{argv}: {done.stdout}{done.stderr}"
    return done.stdout


def eal(*words: str | Path, **env: str) -> str:
    return run(sys.executable, "-m", "eal_actors", *words, **env)


@pytest.fixture(scope="module")
def proof(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Proof:
    folder = tmp_path_factory.mktemp("proof")
    platform = load_definitions().platform(PLATFORM)
    missing = [name for name in (*needed_for(platform), "qemu-system-x86_64", "ssh") if find_tool(name) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (make evbotos-setup)")
    image = load_definitions().image("robot")
    if not (has_kernel(platform, image, Local(version=1)) or request.config.getoption("markexpr") == "evbotos"):
        pytest.skip("no kernel in the cache yet; compiling it takes minutes: `make test-evbotos`")
    fleet = folder / "fleet.yaml"
    fleet.write_text(FLEET)
    eal("keys", "init", "--fleet", fleet)
    eal("keys", "robot", ROBOT, "--fleet", fleet)
    eal("keys", "controller", "controller", "--fleet", fleet)
    robot = folder / "robot"
    (robot / "keys").mkdir(parents=True)
    for name in ("fleet.yaml", "keys/ca.pem", f"keys/{ROBOT}.pem", f"keys/{ROBOT}.key"):
        shutil.copy(folder / name, robot / name)
    ssh_key = folder / "ssh"
    run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", ssh_key)
    public = ssh_key.with_suffix(".pub").read_text().strip()
    local = Local(version=1, ssh_keys=(public,), robot=str(robot))
    built = Build(platform, image, local, _LOG.info).run(folder / "out")
    _LOG.info(f"root and kernel: {built.report['root_with_kernel_mb']} MB")
    return Proof(platform, built, fleet, ssh_key)


@pytest.fixture
def machine(proof: Proof, tmp_path: Path) -> Iterator[Machine]:
    disk = tmp_path / "disk.img"
    shutil.copyfile(proof.built.folder / "disk.img", disk)
    console = tmp_path / "console.log"
    console.write_bytes(b"")
    with running(proof.platform, proof.built.folder, disk, console) as machine:
        yield machine


def first_answer_s(proof: Proof, machine: Machine, monkeypatch: pytest.MonkeyPatch) -> float:
    """Return how long it took from switching on until the first call was answered."""
    start_s = REAL_TIME.now()
    monkeypatch.setenv("EVBOT_PORT", str(machine.ports["eal"]))
    with Fleet.load(proof.fleet) as fleet:
        while REAL_TIME.now() - start_s < LONGEST_BOOT_S:
            assert machine.is_running()
            try:
                fleet[ROBOT]["Base"].get_status(timeout_s=5).get()
                return REAL_TIME.now() - start_s
            except EALError:
                REAL_TIME.sleep(0.2)
    pytest.fail(f"no answer within {LONGEST_BOOT_S} s:\n{machine.console.read_text(errors='replace')}")


def test_a_robot_that_boots_drives_the_square_for_a_controller_outside(
    proof: Proof, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    took_s = first_answer_s(proof, machine, monkeypatch)
    _LOG.warning(
        f"power-on to the first answered call: {took_s:.1f} s, of which QEMU computed {machine.computed_s():.1f} s"
    )
    scenario = Path("scenarios/square.yaml").resolve()
    runs = proof.fleet.with_name("runs")
    port = str(machine.ports["eal"])
    said = eal("run", scenario, "--fleet", proof.fleet, "--runs-dir", runs, EVBOT_PORT=port)
    assert "done" in said
    assert "failed" not in said


def ssh(proof: Proof, machine: Machine, command: str) -> str:
    """Run a command in the image, by the key that may."""
    options = ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "ConnectTimeout=60", "BatchMode=yes")
    words = [word for option in options for word in ("-o", option)]
    return run("ssh", "-q", *words, "-i", proof.ssh_key, "-p", str(machine.ports["ssh"]), "root@127.0.0.1", command)
