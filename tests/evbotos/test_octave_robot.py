"""Octave drives the robot of its own machine, in a booted image that has both."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.facade.service import RobotService
from eal_actors.kernel.log import get_logger
from eal_actors.managers.config import EALConfigManager
from evbotos.definitions import load_definitions
from evbotos.fields import ROOTFS
from evbotos.run_command import memory_for
from tests.evbotos.proof import (
    SERVES,
    answer,
    built_proof,
    ssh,
    started,
    wait_for_words,
)
from tests.net.links import free_port

DRIVE = """
before = eal_call ("evbot", "TruePose", "get_value");
eal_call ("evbot", "Base", "send_cmd", "f0.3");
after = eal_call ("evbot", "TruePose", "get_value");
printf ("%.2f m\\n", norm (after(1:2) - before(1:2)));
tic; for i = 1:50 eal_call ("evbot", "TruePose", "get_value"); end
printf ("%.1f ms for each call\\n", 20 * toc);
try
  eal_call ("evbot", "Base", "send_cmd", "jump");
catch problem
  disp (problem.message);
end
system ("free -k");
"""
_LOG = get_logger()

FLEET = """version: 1
name: one
clock: {rate: max}
robots: {evbot: {plugins: {sim: {model: evbot3}}}}
"""


def test_lines_of_octave_are_answered_in_order_and_wrong_ones_with_words(tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text(FLEET)
    calls = [
        ["evbot", "Base", "send_cmd", ["f0.3"]],
        ["evbot", "TruePose", "get_value", []],
        ["evbot", "Base", "send_cmd", ["jump"]],
        ["evbot", "Base", "connect", []],
        ["evbot", "Wings", "get_value", []],
        ["evbot", "Base", "get_status", []],
    ]
    done = subprocess.run(
        [sys.executable, ROOTFS / "octave-robot/usr/lib/evbotos/octave_robot.py", tmp_path / "fleet.yaml"],
        input="".join(json.dumps(call) + "\n" for call in calls),
        env={**os.environ, "PYTHONPATH": str(ROOTFS / "services/robot/usr/lib/evbotos")},
        capture_output=True,
        text=True,
        check=True,
    )
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert [list(line) for line in told] == [["value"], ["value"], ["error"], ["error"], ["error"], ["value"]], told
    assert len(told[1]["value"]) == 3
    assert "jump" in told[2]["error"]
    assert told[3]["error"].startswith("there is no method 'connect': get_status, get_value")
    assert "Wings" in told[4]["error"]


@pytest.mark.slow  # a fleet waits seconds for its robots
def test_a_robot_that_is_up_after_octave_is_waited_for(tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text(
        f"version: 1\nrobots: {{r1: {{address: 'tcp/127.0.0.1:{free_port()}', plugins: {{sample: {{}}}}}}}}\n"
    )
    with subprocess.Popen(
        [sys.executable, ROOTFS / "octave-robot/usr/lib/evbotos/octave_robot.py", tmp_path / "fleet.yaml"],
        env={**os.environ, "PYTHONPATH": str(ROOTFS / "services/robot/usr/lib/evbotos")},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as octave:
        assert octave.stdin is not None
        assert octave.stdout is not None
        assert octave.stderr is not None
        octave.stdin.write(json.dumps(["r1", "SampleResource", "get_value", []]) + "\n")
        octave.stdin.flush()
        assert "robot is lost" in octave.stderr.readline()
        with RobotService(EALConfigManager.load(tmp_path / "fleet.yaml").fleet, "r1"):
            assert json.loads(octave.stdout.readline()) == {"value": 0}
            octave.communicate()


@pytest.mark.evbotos
@pytest.mark.timeout(3600)
def test_octave_drives_the_robot_of_its_machine(tmp_path: Path) -> None:
    platform, image = load_definitions().chosen("qemu-amd64", "octave-robot")
    without_fleet = {"robot": None, "update_key": None}  # so that programs on the machine may drive
    proof = built_proof(platform, image, tmp_path, settings=without_fleet)
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    assert platform.emulator is not None
    with started(proof, disk, memory_mb=memory_for(platform.emulator, image)) as machine:
        wait_for_words(machine, SERVES)
        for command in image.check:
            answer(proof, machine, command)
        told = ssh(proof, machine, "cat >/run/drive.m && octave-cli --norc /run/drive.m", DRIVE.encode())
        _LOG.warning(f"{told.stdout}{told.stderr}")
        assert "0.30 m" in told.stdout
        assert "eal_call: evbot/Base: " in told.stdout
