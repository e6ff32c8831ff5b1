"""The thesis's square, driven by the drivers of both EvBots through their whole stack (Source: thesis table 6.1)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import run_scenario
from eal_actors.testing import Simulation
from tests.patience import LONG_S, patient_scenario
from tests.unit.plugins.evbot2.wires import evbot2_on_a_pty, evbot3_on

SQUARE = Path(__file__).parents[2] / "scenarios/square.yaml"
PORTS = {"evbot2": {"port": "sim://world/body"}, "evbot3": {"address": "sim://world/body"}}
RATE = 2.5
"""Of the fleet's clock, and of the emulators' time."""
PATIENT = {"watchdog_s": 5.0}  # a delay of a busy machine is not a silent robot
STEP_M = {"evbot2": 0.0005, "evbot3": 0.0002}
TRACK_M = {"evbot2": 0.24, "evbot3": 0.30}


def tolerance(make: str) -> float:
    """Return the largest error, in metres, of eight sides of 0.5 m and eight turns that each err by an encoder step."""
    step_m = STEP_M[make]
    return 8 * (step_m + step_m / TRACK_M[make] * 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("make", ["evbot2", "evbot3"])
def test_in_lock_step_it_ends_where_it_began_by_the_odometry(make: str) -> None:
    robots: dict[str, Any] = {
        "driver": {"plugins": {make: PORTS[make]}},
        "body": {"model": make, "start": (-0.5, 0.5, 0)},
    }
    ends = []
    for _ in range(2):
        with Simulation(robots) as simulation:
            for command in [*["g", "r"] * 4, "s", *["l", "b"] * 4, "s"]:
                assert simulation["driver"]["Base"].send_cmd(command, timeout_s=60).get() == 1
            seen = simulation["driver"]["Odometry"].get_value().get().value
            assert seen == pytest.approx([0.0, 0.0, 0.0], abs=tolerance(make))
            pose = simulation.pose("body")
            assert (pose.x_m, pose.y_m) == pytest.approx((-0.5, 0.5), abs=0.15)  # the wheels of the world err
            ends.append((pose, tuple(seen)))
    assert ends[0] == ends[1]


@contextmanager
def fleet_of(robots: Mapping[str, Mapping[str, Any]]) -> Iterator[Fleet]:
    plain = {name: {"timeout_s": LONG_S, "plugins": plugins} for name, plugins in robots.items()}
    with Fleet(EALConfigManager.of({"version": 1, "clock": {"rate": RATE}, "robots": plain}).fleet) as fleet:
        yield fleet


@pytest.mark.slow
def test_the_shipped_scenario_drives_both_over_real_wires_and_they_end_where_they_began() -> None:
    with ExitStack() as stack:
        path, tracked, _ = stack.enter_context(evbot2_on_a_pty(rate=RATE))
        address, wheeled = stack.enter_context(evbot3_on("udp", rate=RATE))
        robots: dict[str, Any] = {
            "two": {"evbot2": {"port": path, **PATIENT}},
            "three": {"evbot3": {"address": address, **PATIENT}},
        }
        with fleet_of(robots) as fleet:
            for robot in fleet.values():
                robot["Base"].set_config("step_m", 0.2).get()
            report = run_scenario(patient_scenario(SQUARE), fleet)
        assert [robot.outcome for robot in report.robots.values()] == ["done", "done"]
        for make, body in (("evbot2", tracked), ("evbot3", wheeled)):
            left_m, right_m = body.travel_m()
            assert (left_m, right_m) == pytest.approx((0.0, 0.0), abs=16 * STEP_M[make])
            assert body.pose == pytest.approx((0.0, 0.0, 0.0), abs=2 * tolerance(make))
