"""A robot counts controllers that die while it moves."""

from __future__ import annotations

from pathlib import Path

from eal_actors.facade.service import RobotService
from eal_actors.operate.metrics.fleet_metrics import FleetMetrics
from tests.net.links import eventually
from tests.net.rig import Rig, process
from tests.operate.metrics.scraping import samples, scrape

CONTROLLER = """
import sys
from eal_actors import Fleet
with Fleet.load(sys.argv[1]) as fleet:
    move = fleet["r1"]["Arm"].send_cmd("move60")
    print("commanding", flush=True)
    move.exception()
"""


def test_the_trip_of_a_dead_controller_is_counted(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network={"dead_man_s": 0.3})
    place = ("Arm", "r1")
    with RobotService(rig.config, "r1") as service:
        robots = {"r1": service.robot}
        with (
            FleetMetrics(robots, service.robot.clock, 0, service.dead_man_trips) as metrics,
            process(["-c", CONTROLLER, str(rig.file)], tmp_path) as controller,
        ):
            controller.wait_for("commanding")
            assert rig.begun("move60")
            before = samples(scrape(metrics.port))
            controller.kill()
            assert eventually(lambda: service.dead_man_trips.get("Arm") == 1)
            assert eventually(lambda: bool(rig.notes("halt")))
            assert eventually(
                lambda: samples(scrape(metrics.port)).get(("eal_calls_total", ("send_cmd", "preempted", *place))) == 1
            )
            after = samples(scrape(metrics.port))
    assert before["eal_dead_man_trips_total", place] == 0
    assert before["eal_commands_running", ("r1",)] == 1
    assert after["eal_dead_man_trips_total", place] == 1
    assert after["eal_dead_man_trips_total", ("Gauge", "r1")] == 0
    assert after["eal_commands_running", ("r1",)] == 0
