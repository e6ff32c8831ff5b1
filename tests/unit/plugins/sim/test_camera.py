"""The Camera of a simulated robot, as its users know it."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import ArgumentError
from eal_actors.plugin import EALData, Resource
from tests.unit.plugins.sim.rig import Fleet, Robot, arena

ROOT = Path(__file__).parents[4]
SMALL = {"width": 160, "height": 120}


def picture(robot: Robot, **configs: Any) -> NDArray[np.uint8]:
    """Return what a new camera of a robot sees."""
    return frame(camera(robot, **configs))


def camera(robot: Robot, **configs: Any) -> Resource:
    made = robot.resource("Camera")
    for key, value in {**SMALL, **configs}.items():
        made.set_config(key, EALData.of(value))
    return made


def frame(made: Resource) -> NDArray[np.uint8]:
    seen: NDArray[np.uint8] = made.get_value().value
    return seen


def furnished() -> WorldModel:
    """Return a room with posters, a pillar and a box."""
    poster = {"pattern": "poster", "colours": ((245, 240, 225), (200, 60, 50), (50, 90, 170))}
    return arena(
        textures={"poster": poster},
        posters=({"wall": "east", "at_m": 0.2, "texture": "poster"}, {"wall": "north", "at_m": 0, "texture": "poster"}),
        obstacles=({"kind": "circle", "x_m": 2.0, "y_m": 0.8, "radius_m": 0.1},),
        boxes=({"name": "crate", "x_m": 1.0, "y_m": -0.5},),
    )


def test_a_picture_says_where_and_when_it_was_taken() -> None:
    fleet = Fleet(furnished())
    fleet.clock.advance(3.0)
    made = fleet.add("r1", (0, 0, 0)).resource("Camera")
    data = made.get_value()
    assert (data.shape, data.value.dtype) == ((480, 640, 3), np.uint8)
    assert (data.frame_id, data.stamp_s) == ("r1/camera", 3.0)
    info = made.info()
    assert info.value is not None
    info.value.check(data, "Camera")
    assert {config.name for config in info.configs if config.writable} == {
        "width",
        "height",
        "fov_deg",
        "noise",
        "exposure",
        "offset_m",
    }


def test_the_size_is_as_it_is_set() -> None:
    made = camera(Fleet().add("r1", (0, 0, 0)), width=33, height=17)
    assert frame(made).shape == (17, 33, 3)
    assert (made.get_config("width"), made.get_config("height")) == (33, 17)
    for key, value in (("width", 15), ("height", 5000), ("fov_deg", 160.0), ("noise", -1.0), ("exposure", 17.0)):
        with pytest.raises(ArgumentError):
            made.set_config(key, EALData.of(value))


def test_intrinsics_are_those_of_the_lens() -> None:
    made = camera(Fleet().add("r1", (0, 0, 0)), width=200, height=100, fov_deg=90.0)
    data = made.send_req("intrinsics")
    assert data.value.tolist() == [[pytest.approx(100), 0, 99.5], [0, pytest.approx(100), 49.5], [0, 0, 1]]
    returns = made.info().requests[0].returns
    assert returns is not None
    returns.check(data, "intrinsics")


def test_a_wider_field_of_view_holds_the_narrower_one() -> None:
    robot = Fleet(furnished()).add("r1", (0, 0, 0))
    wide = picture(robot, fov_deg=90.0, width=320, height=240)
    narrow = picture(robot, fov_deg=math.degrees(2 * math.atan(0.5)))
    assert np.abs(narrow.astype(int) - wide[60:180, 80:240]).mean() < 2


def test_turning_left_moves_the_picture_to_the_right() -> None:
    robot = Fleet(furnished()).add("r1", (0, 0, 0))
    before = picture(robot, fov_deg=60.0)
    robot.do("l30")
    after = picture(robot, fov_deg=60.0)
    column = 79.5 + 80 / math.tan(math.radians(30)) * math.tan(math.radians(20))
    shifted = 79.5 + 80 / math.tan(math.radians(30)) * math.tan(math.radians(-10))
    assert np.abs(after[40:60, round(column)].astype(int) - before[40:60, round(shifted)]).mean() < 40
    assert not np.array_equal(before, after)


def test_exposure_is_a_factor_that_ends_at_white() -> None:
    robot = Fleet(furnished()).add("r1", (0, 0, 0))
    normal = picture(robot).astype(float)
    assert np.abs(picture(robot, exposure=0.5) - normal / 2).max() <= 1
    assert np.array_equal(picture(robot, exposure=1.5), np.minimum(np.rint(normal * 1.5), 255))
    assert not picture(robot, exposure=0.0).any()


def test_noise_has_its_standard_deviation_and_comes_from_the_seed() -> None:
    def noisy(seed: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]:
        robot = Fleet(furnished(), seed).add("r1", (0, 0, 0))
        made = camera(robot, exposure=0.6, noise=4.0)
        return picture(robot, exposure=0.6), frame(made), frame(made)

    clean, first, second = noisy(1)
    away = first.astype(float) - clean
    assert away.std() == pytest.approx(4.0, rel=0.03)
    assert abs(away.mean()) < 0.1
    assert not np.array_equal(first, second)
    assert np.array_equal(noisy(1)[2], second)
    assert not np.array_equal(noisy(2)[1], first)


def test_without_noise_the_same_scene_gives_the_same_picture() -> None:
    robot = Fleet(furnished()).add("r1", (0, 0, 0))
    made = camera(robot)
    first = frame(made)
    robot.fleet.clock.advance(5.0)
    assert np.array_equal(frame(made), first)
    assert np.array_equal(picture(Fleet(furnished(), seed=9).add("r1", (0, 0, 0))), first)


def test_an_offset_puts_the_camera_ahead_of_the_axis() -> None:
    yaw_rad = math.radians(30)
    ahead = (-1 + 0.1 * math.cos(yaw_rad), 0.1 * math.sin(yaw_rad), 30)
    off = picture(Fleet(furnished()).add("r1", (-1, 0, 30)), offset_m=0.1)
    assert np.abs(off.astype(int) - picture(Fleet(furnished()).add("r1", ahead))).max() <= 1
    made = camera(Fleet().add("r1", (0, 0, 0)))
    assert made.get_config("offset_m") == 0
    with pytest.raises(ArgumentError, match=r"the roomba has a radius of 0\.17 m"):
        made.set_config("offset_m", EALData.of(0.2))


def test_a_camera_on_a_turret_looks_where_the_turret_faces() -> None:
    robot = Fleet(furnished()).add("r1", (0, 0, 0), model="evbot3")
    made = camera(robot)
    assert robot.fleet.run(robot.resource("Turret").send_cmd("l40")) == [1]
    turned = frame(made)
    still = picture(Fleet(furnished()).add("r1", (0, 0, 40), model="evbot3"))
    assert np.abs(turned.astype(int) - still).mean() < 0.5


def test_other_robots_are_seen_where_they_are() -> None:
    fleet = Fleet(furnished())
    robot = fleet.add("r1", (0, 0, 0))
    alone = picture(robot)
    other = fleet.add("r2", (1.0, 0.5, 90), model="evbot3")
    before = picture(robot)
    assert np.flatnonzero((before != alone).any(axis=(0, 2))).max() < 80, "it is on the left"
    other.do("f0.3")
    assert not np.array_equal(picture(robot), before)


def test_a_box_that_is_pushed_is_seen_where_it_is() -> None:
    fleet = Fleet(furnished())
    watcher, pusher = fleet.add("r1", (-1, -0.5, 0)), fleet.add("r2", (1.0, -1.2, 90))
    before = picture(watcher)
    pusher.do("f0.6", "b0.6")
    after = picture(watcher)
    changed = np.flatnonzero((before != after).any(axis=(0, 2)))
    assert len(changed)
    assert changed.min() < 79


def test_without_opencv_a_robot_has_everything_but_a_camera() -> None:
    program = (
        "import sys\n"
        "sys.modules['cv2'] = None\n"
        "from eal_actors.testing import Simulation\n"
        "with Simulation({'r1': 'evbot3', 'r2': 'roomba'}) as fleet:\n"
        "    fleet['r1']['Base'].get_status().get()\n"
        "    print(*fleet['r1'], *fleet['r2'].left_out, sep=';')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    *names, why = done.stdout.splitlines()[-1].split(";")
    assert why == "pictures need OpenCV: pip install 'eal-actors[vision]'"
    assert "Base" in names
    assert "Camera" not in names
    assert (done.stdout + done.stderr).count("Camera is left out: pictures need OpenCV") == 1
