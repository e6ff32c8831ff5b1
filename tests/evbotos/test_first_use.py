"""An image without a fleet: unreachable at first, then a robot of a secured fleet by a USB stick."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos.build import Build
from evbotos.claim_command import claim_machine
from evbotos.errors import BuildError
from evbotos.identity import put_identity
from evbotos.lock import lock_path
from evbotos.model import Local
from evbotos.outputs import Built
from evbotos.provision_command import provision_fleet
from evbotos.qemu import Machine
from evbotos.robot_files import access_files
from evbotos.run_command import trial_identity
from tests.evbotos.proof import SERVES, Proof, answer, eal, said, ssh_words, started, wait_for_words
from tests.evbotos.proofs import plug_in, prove_square, stick_with

_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def bare(proof: Proof, tmp_path_factory: pytest.TempPathFactory) -> Built:
    """The image as it is built without a local.yaml."""
    folder = tmp_path_factory.mktemp("bare")
    lock = lock_path(proof.platform, proof.image)
    return Build(proof.platform, proof.image, Local(version=1), lock, _LOG.info).run(folder)


def is_closed(machine: Machine, service: str) -> bool:
    """Return whether a forwarded port ends at once: nothing listens behind it."""
    with socket.create_connection(("127.0.0.1", machine.ports[service]), timeout=60) as connection:
        try:
            return connection.recv(100) == b""
        except ConnectionResetError:
            return True


def test_a_machine_without_a_fleet_is_reached_by_nobody_until_a_stick_provisions_it(
    proof: Proof, bare: Built, tmp_path: Path
) -> None:
    local = Local(version=1, ssh_keys=((proof.ssh_key.with_suffix(".pub")).read_text(),))
    made = provision_fleet(proof.fleet, None, access_files(local), tmp_path / "identities")
    files = tmp_path / "stick"
    files.mkdir()
    shutil.copy(made["evbot"], files)
    disk = Path(shutil.copyfile(bare.folder / "disk.img", tmp_path / "disk.img"))
    with started(proof, disk) as machine:
        wait_for_words(machine, f"/usr/share/evbotos/fleet.yaml {SERVES}")
        wait_for_words(machine, "at tcp/127.0.0.1:50000")
        assert "publickey" in login_of_a_stranger(proof, machine)
        assert is_closed(machine, "eal")
        plug_in(machine, stick_with(files, tmp_path / "stick.img"))
        wait_for_words(machine, "this machine is evbot from now on: restarting")
        wait_for_words(machine, f"/data/robot/fleet.yaml {SERVES}")
        prove_square(proof, machine)
        assert answer(proof, machine, "hostname").strip() == "evbot"
        known = f"UserKnownHostsFile={tmp_path / 'identities/known_hosts'}"
        strict = [word.replace("UserKnownHostsFile=/dev/null", known) for word in ssh_words(proof, machine)]
        strict = [word.replace("StrictHostKeyChecking=no", "StrictHostKeyChecking=yes") for word in strict]
        strict[1:1] = ["-o", "HostKeyAlias=evbot"]
        subprocess.run([*strict, "true"], check=True, timeout=600)


def login_of_a_stranger(proof: Proof, machine: Machine) -> str:
    """Return the answer to a login without the claim code."""
    words = [word for word in ssh_words(proof, machine) if word != "-q"]
    done = subprocess.run([*words, "true"], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 255
    return done.stderr


def test_the_reader_of_the_claim_code_gives_a_machine_its_identity(proof: Proof, bare: Built, tmp_path: Path) -> None:
    local = Local(version=1, ssh_keys=((proof.ssh_key.with_suffix(".pub")).read_text(),))
    made = provision_fleet(proof.fleet, None, access_files(local), tmp_path / "identities")
    disk = Path(shutil.copyfile(bare.folder / "disk.img", tmp_path / "disk.img"))
    with started(proof, disk) as machine:
        wait_for_words(machine, "--code ")
        (code,) = re.findall(r"evbotos claim \S+ IDENTITY --code (\S+)", said(machine))
        wait_for_words(machine, SERVES)
        assert is_closed(machine, "eal")
        assert "publickey" in login_of_a_stranger(proof, machine)
        wrong = "A" * 16 if not code.startswith("AAAA") else "B" * 16
        with pytest.raises(BuildError, match="another claim code"):
            claim_machine("127.0.0.1", machine.ports["ssh"], wrong, made["evbot"])
        assert claim_machine("127.0.0.1", machine.ports["ssh"], code, made["evbot"]) == "evbot"
        wait_for_words(machine, f"/data/robot/fleet.yaml {SERVES}")
        assert answer(proof, machine, "hostname").strip() == "evbot"
        with pytest.raises(BuildError, match="another claim code"):
            claim_machine("127.0.0.1", machine.ports["ssh"], code, made["evbot"])


def test_of_two_identities_at_the_same_time_a_machine_takes_one(proof: Proof, bare: Built, tmp_path: Path) -> None:
    made = provision_fleet(proof.fleet, None, {}, tmp_path / "identities")
    disk = Path(shutil.copyfile(bare.folder / "disk.img", tmp_path / "disk.img"))
    with started(proof, disk) as machine, ThreadPoolExecutor(2) as pool:
        wait_for_words(machine, SERVES)
        (code,) = re.findall(r"evbotos claim \S+ IDENTITY --code (\S+)", said(machine))
        claims = [pool.submit(claim_machine, "127.0.0.1", machine.ports["ssh"], code, made["evbot"]) for _ in range(2)]
        errors = [claim.exception(600) for claim in claims]
        assert sum(error is None for error in errors) == 1, errors
        wait_for_words(machine, f"/data/robot/fleet.yaml {SERVES}")


def test_the_fleet_file_that_run_names_fits(proof: Proof, bare: Built, tmp_path: Path) -> None:
    disk = Path(shutil.copyfile(bare.folder / "disk.img", tmp_path / "disk.img"))
    put_identity(trial_identity(tmp_path / "trial", Local(version=1)), disk)
    with started(proof, disk) as machine:
        wait_for_words(machine, f"/boot/robot/fleet.yaml {SERVES}")
        fleet, runs = tmp_path / "trial/fleet.yaml", tmp_path / "runs"
        eal("run", "square", "--fleet", fleet, "--runs-dir", runs, EVBOT_PORT=str(machine.ports["eal"]))
