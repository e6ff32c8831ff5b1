"""The proof: an image is built, started in QEMU, and the robot inside drives the square for a controller outside."""

from __future__ import annotations

import random
import shutil
import subprocess
from pathlib import Path

import pytest

from eal_actors.clock import REAL_TIME
from eal_actors.log import get_logger
from evbotos.disk import MIB, parts_of
from evbotos.grub import ENVIRONMENT, parse_environment
from evbotos.qemu import Machine
from evbotos.shell import run as run_tool
from evbotos.shell import run_binary
from evbotos.update import write_update
from tests.evbotos.proof import (
    SERVES,
    Proof,
    answer,
    eal,
    first_answer_s,
    said,
    ssh,
    ssh_words,
    started,
    wait_for_words,
    wait_until,
)

_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


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
    _LOG.warning(f"memory of {proof.platform.emulator}: {answer(proof, machine, 'free -k')}")
    told = eal("run", scenario, "--fleet", proof.fleet, "--runs-dir", runs, EVBOT_PORT=port)
    assert "done" in told
    assert "failed" not in told


def test_what_the_image_promises_of_itself_holds(proof: Proof, machine: Machine) -> None:
    wait_for_words(machine, SERVES)
    for command in proof.image.check:
        answer(proof, machine, command)
    refused = ssh(proof, machine, "touch /ro/usr/bin/x")
    assert refused.returncode != 0
    assert "Read-only file system" in refused.stderr
    assert answer(proof, machine, "cat /etc/shadow").startswith("root:*:")  # no password fits


def stick_with(files: Path, out: Path) -> Path:
    """Make a USB stick, FAT without partitions, with the files of a folder."""
    with out.open("wb") as file:
        file.truncate(16 << 20)
    quiet = {"MTOOLS_SKIP_CHECK": "1"}
    run_tool(["mformat", "-i", out, "-v", "STICK", "-T", str((16 << 20) // 512), "::"], env=quiet)
    run_tool(["mcopy", "-i", out, "-s", "-Q", *sorted(files.iterdir()), "::/"], env=quiet)
    return out


def test_a_stick_with_a_fleet_file_makes_another_robot_of_the_machine(
    proof: Proof, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = tmp_path / "files"
    shutil.copytree(proof.robot_files, files)
    fleet = files / "fleet.yaml"
    fleet.write_text(fleet.read_text().replace("model: evbot3", "model: evbot2"))
    stick = stick_with(files, tmp_path / "stick.img")
    wait_for_words(machine, f"/boot/robot/fleet.yaml {SERVES}")
    first_answer_s(proof, machine, monkeypatch)
    plug_in(machine, stick)
    wait_for_words(machine, f"/media/sda/fleet.yaml {SERVES}")
    first_answer_s(proof, machine, monkeypatch)
    assert "/media/sda" in answer(proof, machine, "cat /run/evbotos/robot.up")
    machine.ask("device_del", id="stick")
    wait_for_words(machine, f"/boot/robot/fleet.yaml {SERVES}", times=2)
    first_answer_s(proof, machine, monkeypatch)


def plug_in(machine: Machine, stick: Path) -> None:
    """Plug a USB stick in."""
    machine.ask("blockdev-add", driver="raw", **{"node-name": "stick"}, file={"driver": "file", "filename": str(stick)})
    machine.ask("device_add", driver="usb-storage", bus="usb.0", id="stick", drive="stick")


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


def test_updates_are_refused_tried_and_fallen_back_from(proof: Proof, machine: Machine, tmp_path: Path) -> None:
    wait_for_words(machine, SERVES)
    before = status(proof, machine)
    assert before == "running a; good a; to be tried none"
    good = update_of(proof, tmp_path).read_bytes()
    tampered = bytearray(good)
    tampered[-len(good) // 3] ^= 1  # in the root
    other = update_of(proof, tmp_path, platform="qemu-arm64").read_bytes()
    for update, words in (
        (bytes(tampered), "is not what was signed"),
        (other, "it is for qemu-arm64, this is qemu-amd64"),
        (good[: len(good) // 2], "refused"),
    ):
        refused = ssh(proof, machine, "evbotos-update install -", update)
        assert refused.returncode == 1, refused.stdout
        assert words in refused.stderr
        assert status(proof, machine) == before

    # Signed, but it never comes up: it is tried once.
    broken = tmp_path / "built/root.squashfs"
    broken.write_bytes(b"no file system" * 10_000)
    update_of_broken = tmp_path / "broken.tar"
    shutil.copyfile(proof.built.folder / "manifest.json", tmp_path / "built/manifest.json")
    write_update(tmp_path / "built", proof.update_key, update_of_broken)
    answer(proof, machine, "evbotos-update install -", update_of_broken.read_bytes())
    assert status(proof, machine).endswith("to be tried b")
    ssh(proof, machine, "reboot")
    wait_for_words(machine, "evbotos: slot b")
    wait_for_words(machine, SERVES, times=2)
    wait_for_good(proof, machine, "a")

    # A good one starts, serves, and stays.
    assert "slot b; the next start tries it" in answer(proof, machine, "evbotos-update install -", good)
    ssh(proof, machine, "reboot")
    wait_for_words(machine, SERVES, times=3)
    wait_for_good(proof, machine, "b")

    # It breaks: after three starts in vain the other one takes over.
    answer(proof, machine, "dd if=/dev/zero of=$(cat /run/evbotos/slot-b) bs=1M count=8 && sync")
    machine.ask("system_reset")
    wait_for_words(machine, "evbotos: slot b did not come up three times")
    wait_for_words(machine, SERVES, times=4)
    wait_for_good(proof, machine, "a")
    assert said(machine).count("Kernel panic") >= 4  # the signed garbage once, the broken slot three times


def test_a_slot_whose_kernel_cannot_be_loaded_makes_way_at_once(proof: Proof, disk: Path) -> None:
    offset, size = parts_of(proof.image.layout).boot
    run_tool(["mcopy", "-o", "-i", f"{disk}@@{offset}", "/dev/null", "::/vmlinuz-b"], env={"MTOOLS_SKIP_CHECK": "1"})
    environment = disk.read_bytes()[offset : offset + size].find(b"good=a\n")
    assert environment > 0
    with disk.open("r+b") as file:
        file.seek(offset + environment)
        file.write(b"good=b\n")
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        wait_for_good(proof, machine, "a")


def environment(disk: Path) -> dict[str, str]:
    """Return GRUB's environment on a disk's boot partition."""
    return parse_environment(run_binary(["mtype", "-i", f"{disk}@@{MIB}", f"::/{ENVIRONMENT}"]))


def test_a_small_drive_starts_the_system_on_the_main_one(proof: Proof, disk: Path, tmp_path: Path) -> None:
    small = Path(shutil.copyfile(proof.built.folder / "boot.img", tmp_path / "boot.img"))
    with disk.open("r+b") as main:
        main.write(bytes(440))  # the main drive cannot start by itself
    with started(proof, disk, boot_drive=small) as machine:
        wait_for_words(machine, SERVES)
        assert "/dev/vda1 on /boot " in answer(proof, machine, "mount")
        assert answer(proof, machine, "cat /run/evbotos/slot-a").strip() == "/dev/vdb2"
        wait_until(machine, "the slot is good", lambda: environment(small)["starts"] == "")
    assert environment(disk)["starts"] == ""  # nobody has touched it


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 20))])
def test_the_power_may_go_at_any_instant_of_an_update(proof: Proof, disk: Path, tmp_path: Path, seed: int) -> None:
    update = update_of(proof, tmp_path)
    cut_at = 1.3 * random.Random(seed).random()  # noqa: S311  # of its bytes; beyond 1, in its last steps and the restart
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        size = update.stat().st_size
        sender = subprocess.Popen(
            [*ssh_words(proof, machine), "evbotos-update install - && reboot"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        assert sender.stdin is not None
        with sender.stdin as pipe:
            pipe.write(update.read_bytes()[: int(size * min(cut_at, 1.0))])
            pipe.flush()
            if cut_at > 1.0:
                pipe.close()
            REAL_TIME.sleep(max(0.0, cut_at - 1.0) * 30.0)
            machine.kill()
        sender.kill()
        sender.wait(60)
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        assert status(proof, machine).startswith("running ")
