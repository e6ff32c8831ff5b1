"""The proof: an image is built, started in QEMU, and the robot inside drives the square for a controller outside."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos import slots
from evbotos.disk import MIB, parts_of
from evbotos.hosttools import find_tool
from evbotos.model import EmulatorLoader
from evbotos.qemu import Machine
from evbotos.shell import run as run_tool
from evbotos.shell import run_binary
from tests.evbotos.power_cuts import prove_cut_update
from tests.evbotos.proof import (
    SERVES,
    Proof,
    answer,
    first_answer_s,
    parse_choice,
    ssh,
    started,
    wait_for_words,
    wait_until,
)
from tests.evbotos.proofs import (
    plug_in,
    prove_square,
    prove_stick,
    prove_updates,
    restart,
    stick_with,
    unplug,
    update_of,
    wait_for_good,
)

OVMF = Path("/usr/share/ovmf/OVMF.fd")
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


def test_a_robot_that_boots_drives_the_square_for_a_controller_outside(
    proof: Proof, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    took_s = first_answer_s(proof, machine, monkeypatch)
    _LOG.warning(
        f"power-on to the first answered call: {took_s:.1f} s, of which QEMU computed {machine.computed_s():.1f} s"
    )
    _LOG.warning(f"memory of {proof.platform.name}: {answer(proof, machine, 'free -k')}")
    prove_square(proof, machine)


def test_what_the_image_promises_of_itself_holds(proof: Proof, machine: Machine) -> None:
    wait_for_words(machine, SERVES)
    for command in proof.image.check:
        answer(proof, machine, command)
    refused = ssh(proof, machine, "touch /ro/usr/bin/x")
    assert refused.returncode != 0
    assert "Read-only file system" in refused.stderr
    assert answer(proof, machine, "cat /etc/shadow").startswith("root:*:")  # no password fits


def test_a_stick_with_a_fleet_file_makes_another_robot_of_the_machine(
    proof: Proof, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prove_stick(proof, machine, tmp_path, monkeypatch)


LET_NO_DRIVER_NEAR = "for bus in /sys/bus/usb/devices/usb*; do echo 0 >$bus/interface_authorized_default; done"
LET_DRIVERS_NEAR = """(
    until stick=$(ls -d /sys/bus/usb/devices/*-[1-9]*:1.0); do sleep 0.1; done
    [ -e $stick/driver ] || : >/tmp/given-up
    echo 1 >$stick/authorized
) >/dev/null 2>&1 &"""


def test_a_stick_that_the_kernel_gave_up_on_is_tried_again(proof: Proof, machine: Machine, tmp_path: Path) -> None:
    stick = stick_with(proof.robot_files, tmp_path / "stick.img")
    wait_for_words(machine, SERVES)
    answer(proof, machine, LET_NO_DRIVER_NEAR)
    answer(proof, machine, LET_DRIVERS_NEAR)  # though the kernel itself does not look for one again
    plug_in(machine, stick)
    wait_for_words(machine, f"/media/sda/fleet.yaml {SERVES}")
    answer(proof, machine, "test -e /tmp/given-up")


def test_a_stick_is_read_with_exfat_and_refused_without_a_file_system(
    proof: Proof, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if find_tool("mkfs.exfat") is None:
        pytest.skip("not installed: exfatprogs (make evbotos-setup)")
    stick = tmp_path / "stick.img"
    with stick.open("wb") as file:
        file.truncate(16 * MIB)
    wait_for_words(machine, SERVES)
    plug_in(machine, stick)
    wait_for_words(machine, "evbotos: sda cannot be read: format it as FAT, exFAT or ext4")
    unplug(machine)
    run_tool(["mkfs.exfat", stick])
    plug_in(machine, stick)
    wait_until(machine, "the stick is mounted", lambda: " exfat ro," in ssh(proof, machine, "cat /proc/mounts").stdout)
    robot = run_binary(["tar", "-C", proof.robot_files, "-c", "."])
    answer(proof, machine, "mount -o remount,rw /media/sda && tar -x -o -C /media/sda && umount /media/sda", robot)
    unplug(machine)
    plug_in(machine, stick)
    wait_for_words(machine, f"/media/sda/fleet.yaml {SERVES}")
    assert "drwxr-x---" in answer(proof, machine, "ls -ld /media/sda")  # keys are for the robot only
    first_answer_s(proof, machine, monkeypatch)


def test_updates_are_refused_tried_and_fallen_back_from(proof: Proof, machine: Machine, tmp_path: Path) -> None:
    prove_updates(proof, machine, tmp_path)


def test_a_slot_whose_kernel_cannot_be_loaded_makes_way_at_once(proof: Proof, disk: Path) -> None:
    offset, size = parts_of(proof.image.layout).boot
    run_tool(["mcopy", "-o", "-i", f"{disk}@@{offset}", "/dev/null", "::/vmlinuz-b"], env={"MTOOLS_SKIP_CHECK": "1"})
    boot = disk.read_bytes()[offset : offset + size]
    environment, hash_a = boot.find(b"good=a\n"), boot.find(b"sectors=")
    hash_b = boot.find(b"# GRUB Environment Block\n" + b"#" * 100)
    assert min(environment, hash_a, hash_b) > 0
    header = len(b"# GRUB Environment Block\n")
    with disk.open("r+b") as file:
        file.seek(offset + environment)
        file.write(b"good=b\n")
        file.seek(offset + hash_b)  # as if slot B had a root
        file.write(boot[hash_a - header : hash_a - header + slots.SIZE])
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        wait_for_good(proof, machine, "a")


def choice(disk: Path) -> dict[str, str]:
    """Return what boot loader and system have told each other on a disk's boot partition."""
    return parse_choice(run_binary(["mtype", "-i", f"{disk}@@{MIB}", f"::/{slots.FILE}"]))


def test_a_small_drive_starts_the_system_on_the_main_one(proof: Proof, disk: Path, tmp_path: Path) -> None:
    small = Path(shutil.copyfile(proof.built.folder / "boot.img", tmp_path / "boot.img"))
    with disk.open("r+b") as main:
        main.write(bytes(440))  # the main drive cannot start by itself
    with started(proof, disk, boot_drive=small) as machine:
        wait_for_words(machine, SERVES)
        assert "/dev/vda1 on /boot " in answer(proof, machine, "mount")
        assert answer(proof, machine, "cat /run/evbotos/slot-a").strip() == "/dev/vdb2"
        wait_until(machine, "the slot is good", lambda: choice(small)["starts"] == "")
    assert choice(disk)["starts"] == ""  # nobody has touched it


def test_a_pc_starts_by_its_uefi_from_an_nvme_disk_and_is_updated(proof: Proof, disk: Path, tmp_path: Path) -> None:
    if not OVMF.is_file():
        pytest.skip("not installed: ovmf (make evbotos-setup)")
    assert proof.platform.emulator is not None
    firmware = EmulatorLoader(package="ovmf", file=OVMF.name, arguments=("-bios", str(OVMF)))
    modern = proof.platform.emulator.model_copy(update={"disk": "nvme", "loader": firmware})
    pc = replace(proof, platform=proof.platform.model_copy(update={"emulator": modern}))
    with started(pc, disk, memory_mb=256) as machine:
        wait_for_words(machine, SERVES)
        assert "/dev/nvme0n1p1 on /boot " in answer(pc, machine, "mount; ls -d /sys/firmware/efi")
        wait_for_good(pc, machine, "a")
        answer(pc, machine, "evbotos-update install -", update_of(pc, tmp_path).read_bytes())
        restart(pc, machine)
        wait_for_words(machine, SERVES, times=2)
        wait_for_good(pc, machine, "b")


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 40))])
def test_the_power_may_go_at_any_instant_of_an_update(proof: Proof, disk: Path, tmp_path: Path, seed: int) -> None:
    prove_cut_update(proof, disk, tmp_path, seed)
