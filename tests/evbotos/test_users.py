"""The image's processes have only the rights that they need, strangers are bounded, and scp works."""

from __future__ import annotations

import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import EALError
from evbotos.qemu import Machine
from tests.evbotos.proof import ROBOT, SERVES, Proof, answer, ssh, ssh_words, started, wait_for_words, wait_until

STRANGERS = 250

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def running(proof: Proof, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """A machine that all tests of this file use, in any order."""
    disk = tmp_path_factory.mktemp("users") / "disk.img"
    shutil.copyfile(proof.built.folder / "disk.img", disk)
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        yield machine


def state_of(proof: Proof, machine: Machine, pid: str) -> dict[str, str]:
    lines = answer(proof, machine, f"cat /proc/{pid}/status").splitlines()
    return {name: " ".join(words.split()) for name, _, words in (line.partition(":") for line in lines)}


@pytest.mark.parametrize(("pid", "uid"), [("$(cat /run/evbotos/robot.pid)", "103"), ("$(pidof mdnsd)", "102")])
def test_robot_and_mdns_have_no_rights_of_root(proof: Proof, running: Machine, pid: str, uid: str) -> None:
    state = state_of(proof, running, pid)
    assert set(state["Uid"].split()) == {uid}
    assert {int(state[name], 16) for name in ("CapInh", "CapPrm", "CapEff", "CapAmb")} == {0}
    assert state["NoNewPrivs"] == "1"


def test_the_robot_s_threads_are_bounded(proof: Proof, running: Machine) -> None:
    limits = answer(proof, running, "cat /proc/$(cat /run/evbotos/robot.pid)/limits").splitlines()
    assert ["Max", "processes", "128", "128", "processes"] in [line.split() for line in limits]


def test_the_robot_reads_its_own_files_and_neither_ssh_s_key_nor_the_boot_partition(
    proof: Proof, running: Machine
) -> None:
    as_robot = "start-stop-daemon -S -q -c robot:robot -x /usr/bin/head -- -c 1"
    answer(proof, running, f"{as_robot} /data/serve/keys/{ROBOT}.key")
    for file in ("/data/ssh/host_ed25519", "/boot/robot/fleet.yaml", f"/boot/robot/keys/{ROBOT}.key"):
        answer(proof, running, f"test -s {file}")
        refused = ssh(proof, running, f"{as_robot} {file}")
        assert refused.returncode != 0
        assert "Permission denied" in refused.stderr


def test_strangers_are_bounded_while_a_controller_is_answered(
    proof: Proof, running: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EVBOT_PORT", str(running.ports["eal"]))
    with Fleet.load(proof.fleet) as fleet, ExitStack() as held:

        def is_answered() -> bool:
            try:
                fleet[ROBOT]["Base"].get_status(timeout_s=60).get()
            except EALError:  # a busy emulator takes longer than the handshake may
                return False
            return True

        wait_until(running, "the first answered call", is_answered)
        for _ in range(STRANGERS):
            connection = held.enter_context(socket.socket())
            connection.settimeout(60)
            connection.connect(("127.0.0.1", running.ports["eal"]))
        fleet[ROBOT]["Base"].get_status(timeout_s=60).get()
        counted = dropped(proof, running)
    assert counted > 0, "nothing was dropped"


def dropped(proof: Proof, machine: Machine) -> int:
    """Return how many packets the firewall has dropped."""
    rules = answer(proof, machine, "nft list chain inet evbotos strangers")
    words = rules.split()
    return sum(int(words[place + 2]) for place, word in enumerate(words) if word == "counter")


HARDENED = {
    "kernel/kptr_restrict": "2",
    "kernel/dmesg_restrict": "1",
    "kernel/randomize_va_space": "2",
    "kernel/yama/ptrace_scope": "1",
    "net/ipv4/tcp_syncookies": "1",
    "fs/protected_symlinks": "1",
    "fs/protected_hardlinks": "1",
}


def test_the_kernel_is_hardened(proof: Proof, running: Machine) -> None:
    told = answer(proof, running, f"cd /proc/sys; grep . {' '.join(HARDENED)}").splitlines()
    assert dict(line.split(":", 1) for line in told) == HARDENED
    absent = ("/dev/mem", "/proc/kcore", "/proc/modules", "/proc/self/ns/user", "/sys/kernel/kexec_loaded")
    for path in absent:
        assert ssh(proof, running, f"test -e {path}").returncode == 1, path
    names = answer(proof, running, "cat /sys/devices/system/cpu/vulnerabilities/*").splitlines()
    assert not [line for line in names if "Vulnerable" in line]
    assert any("Retpolines" in line for line in names), names  # QEMU's processor does not need page table isolation
    hidden = answer(proof, running, "grep -c -v '^00000000' /proc/kallsyms || true").strip()
    assert hidden in ("0", ""), "the kernel's addresses are shown"
    listening = answer(proof, running, "netstat -lntu | awk 'NR > 2 {print $4}'").split()
    assert {place.rpartition(":")[2] for place in listening} <= {"22", "50000", "5353", "7446", "68"}, listening


def test_scp_copies_there_and_back(proof: Proof, running: Machine, tmp_path: Path) -> None:
    words = ssh_words(proof, running)
    options = [word.replace("-p", "-P") for word in words[1:-1]]
    content = bytes(range(256)) * 100
    (tmp_path / "file").write_bytes(content)
    for source, target in (
        (tmp_path / "file", "root@127.0.0.1:/data/copied"),
        ("root@127.0.0.1:/data/copied", tmp_path / "back"),
    ):
        subprocess.run(["scp", *options, source, target], check=True, timeout=600)
    assert (tmp_path / "back").read_bytes() == content
