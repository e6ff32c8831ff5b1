"""Emulators of `eal lab` in one world: wires to robots that meet, and to a camera that sees them."""

from __future__ import annotations

import json
import math
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors import Fleet
from eal_actors.cli.emulators import EmulatorProcesses, open_devices
from eal_actors.kernel.errors import NotReadyError
from eal_actors.managers.config import EALConfigManager
from tests.net.links import eventually
from tests.program import eal_processes

IN_WORLD = """\
version: 1
world: world.yaml
robots:
  bull:
    plugins:
      evbot3: {address: "${LAB_BULL:-udp://127.0.0.1:9}", watchdog_s: 5, poll_hz: 5}
      camera: {source: "${LAB_EYE:-0}", loop: true, timeout_s: 30}
  cape: {plugins: {roomba: {protocol: oi, port: "${LAB_CAPE:-/dev/null/nowhere}", poll_hz: 5}}, pose: {marker: 3}}
  roof:
    plugins:
      tracker:
        cameras:
          only:
            source: "${LAB_ROOF:-rtsp://nowhere}"
            timeout_s: 30
            lens: {size_px: [640, 480], focal_px: [480, 480], centre_px: [319.5, 239.5]}
        markers: [{ids: [3], size_m: 0.24, height_m: 0.15}]
"""
SMALL_WORLD = """\
version: 1
name: ring
size_m: [3, 2]
starts: [{x_m: -0.7, y_m: 0}, {x_m: 0.3, y_m: 0, yaw_deg: 90}]
markers:
  size_m: 0.24
  floor: [{id: 40, x_m: -1.1, y_m: 0.7, size_m: 0.3}, {id: 41, x_m: 1.1, y_m: 0.7, size_m: 0.3},
          {id: 42, x_m: -1.1, y_m: -0.7, size_m: 0.3}, {id: 43, x_m: 1.1, y_m: -0.7, size_m: 0.3}]
cameras: {only: {z_m: 2.4, width: 640, height: 480, fov_deg: 67.38}}
"""


def test_in_a_world_the_emulated_robots_touch_and_a_camera_sees_them(tmp_path: Path) -> None:
    """At a socket, a pseudo-terminal and a stream of pictures: three wires to one world in another process."""
    file = tmp_path / "fleet.yaml"
    file.write_text(IN_WORLD, encoding="utf-8")
    (tmp_path / "world.yaml").write_text(SMALL_WORLD, encoding="utf-8")
    with EmulatorProcesses(open_devices(file), file) as emulators:
        assert emulators.starts == {"bull": (-0.7, 0.0, 0.0), "cape": (0.3, 0.0, pytest.approx(90.0))}
        with Fleet(EALConfigManager.load(file).fleet) as fleet:
            assert eventually(lambda: seen(fleet))
            assert seen(fleet) == pytest.approx((0.3, 0.0, math.pi / 2), abs=0.02)
            assert fleet["bull"]["Battery"].get_value().get().value > 0.98, "its battery is new"
            before = picture(fleet)
            fleet["bull"]["Base"].send_cmd("f0.8").exception()
            assert eventually(lambda: fleet["bull"]["Bump"].get_value().get().value)
            assert np.abs(picture(fleet) - before).mean() > 10, "its camera has the other robot before it"
    x_m, y_m, _ = emulators.poses["bull"]
    assert (x_m, y_m) == pytest.approx((0.3 - 0.37, 0.0), abs=0.03), "it stands at the other one"
    assert emulators.failures == {}


def picture(fleet: Fleet) -> NDArray[np.int16]:
    return np.asarray(fleet["bull"]["Camera"].get_value(timeout_s=60).get().value, np.int16)


def seen(fleet: Fleet) -> tuple[float, ...]:
    """Return the pose of the marked robot in the camera's last picture; empty if it is not in it."""
    try:
        rows = fleet["roof"]["Fixes"].get_value().get().value
    except NotReadyError:
        return ()
    return tuple(rows[0, 1:4]) if len(rows) else ()


@pytest.mark.slow
def test_the_robots_of_a_world_that_died_have_the_reason(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(IN_WORLD, encoding="utf-8")
    (tmp_path / "world.yaml").write_text(SMALL_WORLD, encoding="utf-8")
    devices = [device for device in open_devices(file) if device.plugin.name in ("evbot3", "roomba")]
    with EmulatorProcesses(devices, file) as emulators:
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        (world,) = [pid for pid in children if b"eal_actors.cli.lab_world" in Path(f"/proc/{pid}/cmdline").read_bytes()]
        os.kill(int(world), signal.SIGKILL)
        os.waitid(os.P_PID, int(world), os.WEXITED | os.WNOWAIT)
    assert emulators.failures == dict.fromkeys(["bull", "cape"], "the world of the emulators was killed by SIGKILL")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_panorama_of_the_lab_shows_the_room(tmp_path: Path) -> None:
    """As `eal lab panorama --fleet lab-world`: the pictures of two robots at their wires are stitched to full rings."""
    with eal_processes(tmp_path) as start_eal:
        out, err = start_eal("lab", "panorama", "--fleet", "lab-world", environment=os.environ).communicate(timeout=800)
    assert "panorama on lab-world: done" in out, out + err
    (run,) = (tmp_path / "runs").iterdir()
    for robot in ("evbot2-1", "evbot3-1"):
        told = json.loads((run / robot / "panorama.json").read_text())
        assert told["is_full"], told
        assert [frame["left_out"] for frame in told["frames"]] == [None] * 8
