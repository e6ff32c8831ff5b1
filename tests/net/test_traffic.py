"""Robots in processes of their own that travel together; each has a world of its own, so their estimates judge."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import UnavailableError
from tests.net.links import free_port
from tests.net.rig import serving

FLEET = """
version: 1
name: far
clock: {{rate: 2}}
network: {{dead_man_s: 2.0}}
robots:
  a:
    address: "tcp/127.0.0.1:{ports[0]}"
    plugins: {{sim: {{model: evbot3, start: {{x_m: -0.5, y_m: 0}}}}}}
  b:
    address: "tcp/127.0.0.1:{ports[1]}"
    plugins: {{sim: {{model: roomba, start: {{x_m: 0.5, y_m: 0}}}}}}
"""


@pytest.mark.slow
def test_robots_swap_places_over_the_network_and_one_is_lost(tmp_path: Path) -> None:
    file = tmp_path / "far.yaml"
    file.write_text(FLEET.format(ports=(free_port(), free_port())), encoding="utf-8")
    with serving(file, "a", "b") as servers, Fleet.load(file) as fleet:
        for robot in fleet.values():
            robot.wait_started(60)
        assert fleet.go_to({"a": (0.5, 0.0), "b": (-0.5, 0.0)}).get() == {"a": 1, "b": 1}
        for name, goal in {"a": (0.5, 0.0), "b": (-0.5, 0.0)}.items():
            here = fleet[name].pose.get().get()
            assert math.dist((here.x_m, here.y_m), goal) < 0.01
        journey = fleet.go_to({"a": (-0.5, 1.0), "b": (1.5, 0.0)})
        servers["b"].kill()
        assert isinstance(journey.arrivals["b"].exception(), UnavailableError)
        assert journey.arrivals["a"].exception() is None
