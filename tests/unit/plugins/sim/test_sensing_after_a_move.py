"""Sensors after `TruePose.set_value`: they show the new place at once, without a tick of the world between."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from eal_actors.testing import Simulation

ROOM = {
    "version": 1,
    "name": "room",
    "size_m": (6, 4),
    "obstacles": [{"kind": "box", "x_m": 0.0, "y_m": 0.0, "size_m": [0.3, 1.0], "height_m": 1.0}],
    "beacons": [{"name": "dock", "x_m": 2.5, "y_m": 0.0}],
    "lighting": {"ambient_lux": 100.0, "lamps": [{"x_m": 2.0, "y_m": 0.0, "lumens": 2600}]},
}
HERE, THERE = (-1.5, 0.0, 0.0), (1.0, 1.0, 0.5)
SENSORS = ("Range", "Light", "Beacons", "Compass", "Bump", "Wall", "Cliff", "WheelDrop", "Camera")


def robots_at(a: tuple[float, float, float], b: tuple[float, float, float]) -> dict[str, Any]:
    places = {"a": a, "b": b}
    return {
        name: {
            "model": "roomba",
            "noise": False,
            "start": {"x_m": x_m, "y_m": y_m, "yaw_deg": float(np.degrees(yaw_rad))},
        }
        for name, (x_m, y_m, yaw_rad) in places.items()
    }


def readings(simulation: Simulation, robot: str) -> dict[str, Any]:
    return {name: np.asarray(simulation[robot][name].get_value().get().value) for name in SENSORS}


@pytest.mark.parametrize("mover", ["a", "b"])
def test_a_carried_robot_and_its_neighbour_sense_the_new_place_at_once(mover: str) -> None:
    places = {"a": HERE, "b": (-1.5, 1.2, 0.0)}
    with Simulation(robots_at(**{**places, mover: THERE}), world=ROOM) as simulation:
        expected = {name: readings(simulation, name) for name in places}
    with Simulation(robots_at(**places), world=ROOM) as simulation:
        before = {name: readings(simulation, name) for name in places}
        now_s = simulation.now_s
        simulation[mover]["TruePose"].set_value(list(THERE)).get()
        for name in places:
            for sensor, reading in readings(simulation, name).items():
                np.testing.assert_allclose(reading, expected[name][sensor], atol=1e-6, err_msg=f"{name}.{sensor}")
        assert simulation.now_s == now_s  # no tick passed
    assert not np.array_equal(before["a"]["Range"], expected["a"]["Range"])
    assert not np.array_equal(before["b"]["Range"], expected["b"]["Range"])
    assert before[mover]["Light"] != expected[mover]["Light"]
