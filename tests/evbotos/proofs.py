"""The proofs of every board: its robot drives, a stick changes its fleet file, updates fall back."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from evbotos.disk import parts_of
from evbotos.errors import BuildError
from evbotos.qemu import Machine
from evbotos.shell import run as run_tool
from evbotos.update import write_update
from tests.evbotos.proof import (
    SERVES,
    Proof,
    answer,
    eal,
    first_answer_s,
    said,
    ssh,
    wait_for_words,
    wait_until,
)

RESETS_NOT = ("beagle-armhf", "raspberry-pi")
"""QEMU lacks the watchdogs of these boards, so it resets them itself."""

TOO_SLOW = ("does not answer at", "s old at most", "waited too long to be begun")
"""Errors of limits in real time, 3 s for a connection and 1 s for a command; an emulator on a busy host is slower."""


def prove_square(proof: Proof, machine: Machine) -> None:
    """The robot inside drives the square for a controller outside."""
    scenario = Path("scenarios/square.yaml").resolve()
    runs = proof.fleet.with_name("runs")
    told: list[str] = []

    def is_driven() -> bool:
        port = str(machine.ports["eal"])
        try:
            told.append(eal("run", scenario, "--fleet", proof.fleet, "--runs-dir", runs, EVBOT_PORT=port))
        except AssertionError as error:
            if any(words in str(error) for words in TOO_SLOW):
                return False
            raise
        return True

    wait_until(machine, "the robot drives the square", is_driven)
    assert "done" in told[0]
    assert "failed" not in told[0]


def stick_with(files: Path, out: Path) -> Path:
    """Make a USB stick, FAT without partitions, with the files of a folder."""
    with out.open("wb") as file:
        file.truncate(16 << 20)
    quiet = {"MTOOLS_SKIP_CHECK": "1"}
    run_tool(["mformat", "-i", out, "-v", "STICK", "-T", str((16 << 20) // 512), "::"], env=quiet)
    run_tool(["mcopy", "-i", out, "-s", "-Q", *sorted(files.iterdir()), "::/"], env=quiet)
    return out


def prove_stick(proof: Proof, machine: Machine, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stick with a fleet file makes another robot of the machine, as long as it is plugged in."""
    files = folder / "files"
    shutil.copytree(proof.robot_files, files)
    fleet = files / "fleet.yaml"
    fleet.write_text(fleet.read_text().replace("model: evbot3", "model: evbot2"))
    stick = stick_with(files, folder / "stick.img")
    wait_for_words(machine, f"/boot/robot/fleet.yaml {SERVES}")
    first_answer_s(proof, machine, monkeypatch)
    plug_in(machine, stick)
    place = f"/media/{stick_name(proof)}"
    wait_for_words(machine, f"{place}/fleet.yaml {SERVES}")
    first_answer_s(proof, machine, monkeypatch)
    assert place in answer(proof, machine, "cat /run/evbotos/robot.up")
    machine.ask("device_del", id="stick")
    wait_for_words(machine, f"/boot/robot/fleet.yaml {SERVES}", times=2)
    first_answer_s(proof, machine, monkeypatch)


def stick_name(proof: Proof) -> str:
    """Return what the kernel calls the first stick."""
    emulator = proof.platform.emulator
    assert emulator is not None
    return "sdb" if emulator.disk == "ide-hd" else "sda"  # the disk itself is sda then


def plug_in(machine: Machine, stick: Path) -> None:
    """Plug a USB stick in."""
    machine.ask("blockdev-add", driver="raw", **{"node-name": "stick"}, file={"driver": "file", "filename": str(stick)})
    machine.ask("device_add", driver="usb-storage", id="stick", drive="stick")


def unplug(machine: Machine) -> None:
    """Pull the USB stick out."""
    machine.ask("device_del", id="stick")

    def is_out() -> bool:
        try:
            machine.ask("blockdev-del", **{"node-name": "stick"})
        except BuildError:  # the device still has it
            return False
        return True

    wait_until(machine, "the stick is out", is_out)


def update_of(proof: Proof, folder: Path, **changes: str) -> Path:
    """Make a signed update of the built image, with changes of what its manifest says."""
    built = folder / "built"
    built.mkdir(exist_ok=True)
    for name in ("kernel", "root.squashfs", "manifest.json"):
        shutil.copyfile(proof.built.folder / name, built / name)
    manifest = built / "manifest.json"
    for name, value in changes.items():
        text = manifest.read_text()
        assert f'"{name}": "{proof.built.report[name]}"' in text
        manifest.write_text(text.replace(f'"{name}": "{proof.built.report[name]}"', f'"{name}": "{value}"'))
    out = folder / "update.tar"
    write_update(built, proof.update_key, out)
    return out


def status(proof: Proof, machine: Machine) -> str:
    return answer(proof, machine, "evbotos-update status").strip()


def wait_for_good(proof: Proof, machine: Machine, slot: str) -> None:
    wait_until(
        machine, f"slot {slot} is good", lambda: f"running {slot}; good {slot}" in ssh_status(proof, machine), 120
    )


def ssh_status(proof: Proof, machine: Machine) -> str:
    return ssh(proof, machine, "evbotos-update status").stdout


def restart(proof: Proof, machine: Machine) -> None:
    """Restart a machine cleanly."""
    if proof.platform.name in RESETS_NOT:
        answer(proof, machine, "sync")
        machine.ask("system_reset")
    else:
        ssh(proof, machine, "reboot")


def let_it_panic(proof: Proof, machine: Machine, times: int) -> None:
    """Wait until a system has died so many times in all, after which it starts anew."""
    wait_for_words(machine, "Kernel panic", times=times)
    if proof.platform.name in RESETS_NOT:
        machine.ask("system_reset")


def change_block(machine: Machine, offset: int) -> None:
    """Overwrite a block of the disk, as a decaying card or an attacker does, and start anew."""
    machine.ask("stop")
    machine.monitor(f'qemu-io disk "write -P 0xa5 {offset} 4096"')
    machine.ask("system_reset")
    machine.ask("cont")


def prove_updates(proof: Proof, machine: Machine, folder: Path) -> None:
    """Updates are refused, tried, kept, and fallen back from."""
    wait_for_words(machine, SERVES)
    before = status(proof, machine)
    assert before == "running a; good a; to be tried none"
    good = update_of(proof, folder).read_bytes()
    tampered = bytearray(good)
    tampered[-len(good) // 3] ^= 1  # in the root
    older = update_of(proof, folder, release="0.0.1.1").read_bytes()
    name = proof.platform.name
    other = update_of(proof, folder, platform="toaster").read_bytes()
    for update, words in (
        (bytes(tampered), "is not what was signed"),
        (other, f"it is for toaster, this is {name}"),
        (older, "its release 0.0.1.1 is older than"),
        (good[: len(good) // 2], "refused"),
    ):
        refused = ssh(proof, machine, "evbotos-update install -", update)
        assert refused.returncode == 1, refused.stdout
        assert words in refused.stderr
        assert status(proof, machine) == before

    # Signed, but it never comes up: it is tried once.
    broken = folder / "built/root.squashfs"
    broken.write_bytes(b"no file system" * 10_000)
    update_of_broken = folder / "broken.tar"
    shutil.copyfile(proof.built.folder / "manifest.json", folder / "built/manifest.json")
    write_update(folder / "built", proof.update_key, update_of_broken)
    answer(proof, machine, "evbotos-update install -", update_of_broken.read_bytes())
    assert status(proof, machine).endswith("to be tried b")
    restart(proof, machine)
    wait_for_words(machine, "evbotos: slot b")
    let_it_panic(proof, machine, 1)
    wait_for_words(machine, SERVES, times=2)
    wait_for_good(proof, machine, "a")

    # A good one starts, serves, and stays.
    assert "slot b; the next start tries it" in answer(proof, machine, "evbotos-update install -", good)
    restart(proof, machine)
    wait_for_words(machine, SERVES, times=3)
    wait_for_good(proof, machine, "b")

    # One block of it changes: the kernel does not run it, and after three starts in vain the other slot takes over.
    change_block(machine, parts_of(proof.image.layout).slot_b[0] + (1 << 20))
    for times in (2, 3, 4):
        let_it_panic(proof, machine, times)
    assert "dm-verity device corrupted" in said(machine)
    wait_for_words(machine, "evbotos: slot b did not come up three times")
    wait_for_words(machine, SERVES, times=4)
    wait_for_good(proof, machine, "a")
