"""The services of the image besides the robot."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from evbotos.qemu import Machine
from tests.evbotos.proof import Proof, answer, said, ssh, started, wait_until
from tests.evbotos.usb_camera import UsbCamera

KEPT_MOST = 200_000 + 1_200
"""Bytes that are kept of a log: two files that end with the line that makes them larger than the half of it."""

SLEEPS = "/usr/bin/sleep 100000"

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def running(proof: Proof, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """A machine that all tests of this file use, in any order."""
    disk = tmp_path_factory.mktemp("services") / "disk.img"
    shutil.copyfile(proof.built.folder / "disk.img", disk)
    with started(proof, disk) as machine:
        yield machine


def wait_for_robot(proof: Proof, machine: Machine, but: str = "none") -> str:
    """Wait until a robot serves that is another process than one before; returns its process's number."""
    pid = but

    def serves() -> bool:
        nonlocal pid
        pid = ssh(proof, machine, "test -s /run/evbotos/robot.up && cat /run/evbotos/robot.pid").stdout.strip() or but
        return pid != but

    wait_until(machine, f"another robot than {but} serves", serves)
    return pid


def test_a_robot_that_ends_is_started_anew(proof: Proof, running: Machine) -> None:
    before = wait_for_robot(proof, running)
    answer(proof, running, f"kill -9 {before}")
    wait_for_robot(proof, running, before)


def test_what_a_robot_has_started_ends_with_it(proof: Proof, running: Machine) -> None:
    """It counted against the threads of the next robot, or held up its start, since it had the log open."""
    before = wait_for_robot(proof, running)
    start = "start-stop-daemon -S -q -c robot:robot -x /usr/bin/sleep -- 100000"
    answer(proof, running, f"{start} </dev/null >/proc/{before}/fd/1 2>&1 &")
    wait_until(running, "it runs", lambda: SLEEPS in answer(proof, running, "ps"))
    answer(proof, running, f"kill -9 {before}")
    wait_for_robot(proof, running, before)
    assert SLEEPS not in answer(proof, running, "ps")


def test_a_system_that_hangs_is_started_anew_by_the_hardwares_watchdog(proof: Proof, running: Machine) -> None:
    wait_for_robot(proof, running)
    starts = said(running).count("evbotos: slot a")
    answer(proof, running, "kill -STOP $(pidof watchdog)")
    wait_until(running, "the watchdog starts it anew", lambda: said(running).count("evbotos: slot a") > starts)
    wait_for_robot(proof, running)


def test_a_usb_serial_adapter_has_a_name_that_stays(proof: Proof, running: Machine) -> None:
    wait_for_robot(proof, running)
    look = "for link in /dev/serial/by-id/*; do echo $link $(readlink -f $link); done"
    running.ask("chardev-add", id="line", backend={"type": "null", "data": {}})
    plugged = {"always-plugged": True}  # whether or not somebody is at the other end of its line
    running.ask("device_add", driver="usb-serial", bus="usb.0", id="adapter", chardev="line", serial="A1", **plugged)
    wait_until(running, "the adapter has its name", lambda: "/dev/ttyUSB0" in ssh(proof, running, look).stdout)
    name, device = answer(proof, running, look).split()
    assert name == "/dev/serial/by-id/usb-QEMU_QEMU_USB_SERIAL_A1-if00-port0"  # as udev names it
    assert device == "/dev/ttyUSB0"
    running.ask("device_del", id="adapter")
    wait_until(running, "its name is gone", lambda: name not in ssh(proof, running, look).stdout)


def test_what_is_kept_of_logs_is_bounded(proof: Proof, running: Machine) -> None:
    wait_for_robot(proof, running)
    line = "x" * 1000
    answer(proof, running, f"for _ in $(seq 350); do echo {line}; done | /usr/lib/evbotos/keep-log trial")
    kept = answer(proof, running, "cat /data/log/trial.log.1 /data/log/trial.log | wc -c")
    assert 100_000 < int(kept) < KEPT_MOST
    assert answer(proof, running, "tail -n 1 /data/log/trial.log").endswith(f" {line}\n")
    assert "syslogd -n -C128" in answer(proof, running, "ps")  # the rest is in RAM alone


def test_a_usb_camera_comes_up_by_itself(proof: Proof, running: Machine, tmp_path: Path) -> None:
    wait_for_robot(proof, running)
    find = "readlink -f /dev/v4l/by-id/usb-1d6b_Emulated_Camera-video-index0"
    with UsbCamera(tmp_path / "usb") as camera:
        camera.plug_into(running)
        wait_until(running, "the camera has its name", lambda: "/dev/video0" in ssh(proof, running, find).stdout)
        camera.unplug_from(running)
        wait_until(
            running, "it is gone", lambda: ssh(proof, running, "ls -d /dev/video0 /dev/v4l/by-id/*").stdout == ""
        )


def test_updates_are_served_after_their_pipe_was_opened_in_vain(proof: Proof, running: Machine) -> None:
    wait_for_robot(proof, running)
    wake = "/run/evbotos/update.wake"
    wait_until(running, "updates are served", lambda: ssh(proof, running, f"test -p {wake}").returncode == 0)
    answer(proof, running, f"true >{wake}")  # as a robot does that ends before it writes
    answer(proof, running, f"timeout 120 sh -c 'echo >{wake}'")  # opening it waits for a reader
