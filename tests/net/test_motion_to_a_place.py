"""Motions to a place of a robot in a process of its own: the loop runs there, and its outcomes arrive here."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors import Fleet, LocalizationError
from eal_actors.classic import DOUBLE, EALconnect, EALDataInfo_t, EALdisconnect
from eal_actors.kernel.errors import ArgumentError, PreemptedError
from tests.net.links import eventually, free_port
from tests.net.rig import serving

ROBOT = "evbot3-1"
FLEET = """
version: 1
name: far
clock: {{rate: 2}}
robots:
  evbot3-1:
    address: "tcp/127.0.0.1:{port}"
    plugins: {{sim: {{model: evbot3, start: {{x_m: 0, y_m: 0, yaw_deg: 0}}}}}}
"""


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    file = tmp_path / "far.yaml"
    file.write_text(FLEET.format(port=free_port()), encoding="utf-8")
    monkeypatch.setenv("EAL_FLEET", str(file))
    with serving(file, ROBOT), Fleet.load(file) as fleet:
        fleet[ROBOT].wait_started(60)
        yield fleet


def off_m(fleet: Fleet, x_m: float, y_m: float) -> float:
    """Return the distance of the estimated pose from a place: simulated wheels err, and no tracker corrects them."""
    here = fleet[ROBOT].pose.get().get()
    return math.hypot(here.x_m - x_m, here.y_m - y_m)


def test_it_is_sent_stopped_and_refused_over_the_network(fleet: Fleet) -> None:
    robot = fleet[ROBOT]
    motion = robot.base.go_to(0.3, 0.1, 90)
    motion.get()
    progress = motion.progress()
    assert progress is None or 0 <= (progress.fraction or 0) <= 1
    assert off_m(fleet, 0.3, 0.1) < 0.01
    assert abs(robot.pose.get().get().yaw_rad - math.pi / 2) < math.radians(2)
    robot.base.follow([(0.3, 0.2), (0.1, 0.2)]).get()
    assert off_m(fleet, 0.1, 0.2) < 0.01
    far = robot.base.go_to(3.0, 0.0)
    assert eventually(lambda: off_m(fleet, 0.1, 0.2) > 0.01)  # a stop that overtakes it makes it stale
    robot.base.stop().get()
    assert isinstance(far.exception(), PreemptedError)
    assert isinstance(robot.base.follow([]).exception(), ArgumentError)
    robot.pose.set(0.0, 0.0, 0.0).get()  # by hand, within 1 cm
    robot["Base"].set_config("max_uncertainty_m", 0.0101).get()
    error = robot.base.follow([(3.0, 0.0), (-3.0, 0.0)] * 9).exception()
    assert isinstance(error, LocalizationError), error
    assert (error.robot, error.resource) == (ROBOT, "Base")
    assert robot["Base"].get_status().get() == 0


def test_the_thesiss_calls_send_it(fleet: Fleet) -> None:
    eal = EALconnect(ROBOT)
    assert eal is not None
    base = eal.findResource("Base")
    goal = EALDataInfo_t(DOUBLE, [0.2, 0.1, 0.0], isPtr=True)
    assert eal.sendCmd(base, "goto", goal) == 1
    path = EALDataInfo_t(DOUBLE, [0.3, 0.1, 0.3, 0.0], isPtr=True)
    assert eal.sendCmd(base, "follow", path) == 1
    assert eal.sendCmd(base, "goto", EALDataInfo_t(DOUBLE, [0.2], isPtr=True)) == -1
    EALdisconnect(eal)
    assert off_m(fleet, 0.3, 0.0) < 0.01
