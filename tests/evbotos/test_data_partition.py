"""A data partition that is full, read-only or damaged: the machine comes up and says what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from evbotos.disk import parts_of
from evbotos.qemu import Machine
from tests.evbotos.proof import ROBOT, SERVES, Proof, answer, said, started, wait_for_words
from tests.evbotos.proofs import restart

_JOURNAL = bytes.fromhex("c03b3998 00000004")
"""How the journal's superblock begins."""

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


def test_a_damaged_data_partition_can_still_be_read_and_says_so(proof: Proof, disk: Path) -> None:
    offset, size = parts_of(proof.image.layout).data
    with disk.open("r+b") as file:
        file.seek(offset)
        journal = file.read(size).index(_JOURNAL)
        file.seek(offset + journal)
        file.write(bytes(len(_JOURNAL)))
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        assert "the data partition is damaged: flash the card again" in said(machine)
        assert "the data partition cannot be written" in said(machine)
        assert "/data ext4 ro," in answer(proof, machine, "cat /proc/mounts")  # SSH has a host key, too
        assert SERVES in answer(proof, machine, "logread")


def test_a_robot_starts_with_a_full_data_partition_and_files_in_place_of_folders(
    proof: Proof, machine: Machine
) -> None:
    wait_for_words(machine, SERVES)
    answer(proof, machine, "rm -r /data/log; : >/data/log; cp -r /boot/robot/fleet.yaml /boot/robot/keys /data/robot")
    answer(proof, machine, "cat /boot/robot/keys/* /boot/robot/keys/* >/data/robot/keys/more")
    answer(proof, machine, "dd if=/dev/zero of=/data/fill bs=64k || dd if=/dev/zero of=/data/rest bs=512; true")
    answer(proof, machine, "kill $(cat /run/evbotos/robot.pid)")
    wait_for_words(machine, SERVES, times=2)
    assert "the data partition cannot be written" in said(machine)
    answer(proof, machine, f"cmp /run/serve/keys/{ROBOT}.key /data/robot/keys/{ROBOT}.key")
    answer(proof, machine, "rm /data/fill /data/rest; kill $(cat /run/evbotos/robot.pid)")
    wait_for_words(machine, SERVES, times=3)
    assert said(machine).count("the data partition cannot be written") == 1
    answer(proof, machine, "cmp /data/serve/keys/more /data/robot/keys/more")


def test_a_restart_lets_the_robot_halt_first_and_leaves_the_partition_clean(proof: Proof, machine: Machine) -> None:
    wait_for_words(machine, SERVES)
    restart(proof, machine)
    wait_for_words(machine, SERVES, times=2)
    assert "halted; leaving the network" in answer(proof, machine, "cat /data/log/robot.log")
    assert "recovery complete" not in answer(proof, machine, "dmesg")
