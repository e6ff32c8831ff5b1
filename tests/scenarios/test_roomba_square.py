"""The square through the whole stack: fleet file, actors, driver, wire protocol, emulator, robot."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.managers.config import EALConfigManager

FLEET = """\
version: 1
name: roombas
clock: {{rate: max}}
world: floor.yaml
robots:
  body:
    plugins:
      sim: {{model: roomba, noise: false}}
  driven:
    plugins:
      roomba: {{protocol: {protocol}, port: "sim://world/body"{settings}}}
"""

WORLD = """\
version: 1
name: floor
size_m: [6.0, 4.0]
"""

SIDE_M = 0.5
SQUARE = [f"f{SIDE_M}", "l90"] * 4
ARM_M = 0.129
OFF_COUNTS = 1.5
"""Tolerance in counts at the end of a motion."""
COUNT_M = {"sci": 0.001, "oi": math.pi * 0.072 / 508.8}
"""Resolution of the counters of each interface."""


@pytest.mark.parametrize(
    ("protocol", "settings"),
    [
        ("sci", ", link: sim"),
        ("sci", ", link: mote"),
        ("sci", ", link: mote, mode: full, mote: {header: tinyos1}"),
        ("oi", ", link: sim"),
    ],
)
def test_the_square_ends_where_it_should(protocol: str, settings: str, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(FLEET.format(protocol=protocol, settings=settings), encoding="utf-8")
    (tmp_path / "floor.yaml").write_text(WORLD, encoding="utf-8")
    with Fleet(EALConfigManager.load(file, environment={}).fleet) as fleet:
        base, odometry, pose = fleet["driven"]["Base"], fleet["driven"]["Odometry"], fleet["body"]["TruePose"]
        x_m, y_m, yaw_rad = pose.get_value().get().value
        for move in SQUARE:
            assert base.send_cmd(move).get() == 1
        end_x_m, end_y_m, end_yaw_rad = pose.get_value().get().value
        believed = odometry.get_value().get().value
    turn_rad = OFF_COUNTS * COUNT_M[protocol] / ARM_M  # tolerance of each turn, and of each side in counts
    assert abs(math.remainder(end_yaw_rad - yaw_rad, math.tau)) < 4 * turn_rad
    assert math.hypot(end_x_m - x_m, end_y_m - y_m) < 4 * OFF_COUNTS * COUNT_M[protocol] + SIDE_M * 2 * turn_rad
    truth = (end_x_m - x_m, end_y_m - y_m, math.remainder(end_yaw_rad - yaw_rad, math.tau))
    assert believed[:2] == pytest.approx(truth[:2], abs=0.012)
    assert believed[2] == pytest.approx(truth[2], abs=2 * COUNT_M[protocol] / ARM_M)  # two counts of the angle
