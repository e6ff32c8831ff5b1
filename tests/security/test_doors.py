"""Every door that can command, opened with the certificate of an observer, or of an operator of some robots.

None moves a robot: access control sees to that, in tests/net/test_tls.py. Here each refuses before anything moves, and
says why; what the certificate permits works.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import AccessDeniedError, ConfigError
from eal_actors.managers.keys.certificates import make_certificate
from eal_actors.operate.agents import PlanGate
from eal_actors.operate.dashboard.control import ControlRegistry
from eal_actors.operate.dashboard.teleop import Teleop, Twist
from eal_actors.operate.hands import HandDriver, HandSettings, InputSource
from eal_actors.scenario.engine.plan import make_plan
from eal_actors.scenario.engine.run import run_scenario
from eal_actors.scenario.language.loading import load_scenario
from tests.net.rig import Rig, becomes
from tests.security.forging import as_seen_by, make_keys
from tests.security.test_revocation import invoke

DRIVE = """\
version: 1
name: drive
roles: {everyone: {}}
steps:
  - on: everyone
    do:
      - send_cmd: {resource: Base, cmd: f0.1}
"""
READ = DRIVE.replace("drive", "read").replace("send_cmd: {resource: Base, cmd: f0.1}", "get_value: {resource: Pose}")
GO_TO = DRIVE.replace("send_cmd: {resource: Base, cmd: f0.1}", "go_to: {place: [0.3, 0.3]}")
DENIED = "does not grant {} to '{}', which has the role observer there"


@dataclass
class Site:
    """Two simulated robots; `mate` and `driver` command the first, and `mate` observes the second."""

    rig: Rig
    stack: ExitStack

    def opened(self, name: str) -> Fleet:
        """Connect with the certificate of a name."""
        fleet = self.stack.enter_context(Fleet(as_seen_by(self.rig.config, name)).connect())
        assert all(becomes(robot, RobotState.READY) for robot in fleet.values())
        return fleet

    def file(self, text: str) -> Path:
        file = self.rig.folder / "scenario.yaml"
        file.write_text(text, encoding="utf-8")
        return file

    def fleet_file(self, name: str) -> Path:
        """Write the fleet file of a program with the certificate of a name."""
        file = self.rig.folder / f"{name}.yaml"
        content = {"version": 1, "name": "f", "include": [self.rig.file.name]}
        file.write_text(json.dumps({**content, "network": {"security": {"controller": name}}}), encoding="utf-8")
        return file


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    folder = make_keys(tmp_path / "keys")
    make_certificate(folder, "r2", ["127.0.0.1"])
    limited = [{"name": name, "robots": ["r1"]} for name in ("mate", "driver")]
    roles = {"controllers": ["controller", *limited], "observers": ["display", "mate"]}
    security = {"keys": str(folder), "roles": roles}
    rig = Rig(tmp_path, ("r1", "r2"), {"security": security}, protocol="tls", extra={"clock": {"rate": 1}})
    for robot in rig.content["robots"].values():
        robot["plugins"] = {"sim": {"model": "evbot3", "noise": False}}
    rig.write()
    with ExitStack() as stack:
        for robot in ("r1", "r2"):
            stack.enter_context(RobotService(rig.config, robot))
        yield Site(rig, stack)


def places(fleet: Fleet) -> list[list[float]]:
    return [robot["TruePose"].get_value().get().value.tolist() for robot in fleet.values()]


@pytest.mark.parametrize(("name", "refused"), [("display", "r1, r2"), ("mate", "r2")])
@pytest.mark.parametrize("text", [DRIVE, GO_TO])
def test_a_scenario_is_refused_before_a_robot_of_it_moves(site: Site, name: str, refused: str, text: str) -> None:
    """One of an operator of some robots moved these before it came to the others."""
    fleet = site.opened(name)
    with pytest.raises(ConfigError) as caught:
        make_plan(load_scenario(site.file(text)), fleet)
    told = [problem for problem in caught.value.problems if "does not grant" in problem.message]
    assert [problem.message for problem in told] == [f"{refused}: Base {DENIED.format('send_cmd', name)}"]
    assert told[0].line == 7
    assert places(fleet) == [[0.0, 0.0, 0.0]] * 2


@pytest.mark.parametrize("name", ["display", "mate"])
def test_a_scenario_that_reads_ends_well(site: Site, name: str) -> None:
    """It failed: at its end the robots are halted, which an observer may not do either."""
    fleet = site.opened(name)
    report = run_scenario(site.file(READ), fleet)
    assert report.outcome == "done", report


def test_an_operator_runs_what_is_for_the_own_robots(site: Site) -> None:
    fleet = site.opened("mate")
    report = run_scenario(site.file(DRIVE), fleet, binding={"everyone": ["r1"]})
    assert report.outcome == "done", report
    assert places(fleet)[0][0] > 0.05


def test_an_agent_is_refused(site: Site) -> None:
    with pytest.raises(ConfigError, match=DENIED.format("send_cmd", "display")):
        PlanGate(site.opened("display"), site.rig.folder).examine(DRIVE, {})


def test_a_hand_is_refused_before_it_presses(site: Site) -> None:
    fleet = site.opened("mate")
    read, write = os.pipe()
    os.close(write)
    source = InputSource("pipe", read, {})
    try:
        with pytest.raises(AccessDeniedError, match=f"r2/Base: {DENIED.format('set_value', 'mate')}"):
            HandDriver(fleet, ["r1", "r2"], HandSettings(), lambda _: None).run(source)
    finally:
        source.close()


def test_driving_from_the_page_is_refused(site: Site) -> None:
    fleet, errors = site.opened("display"), list[str]()
    teleop = Teleop(fleet, ControlRegistry())
    with pytest.raises(AccessDeniedError, match=DENIED.format("set_value", "display")):
        teleop.drive("browser", "r1", 1, Twist(0.2, 0.0), lambda robot, _: errors.append(robot))
    assert errors == []


def test_eal_stop_tells_who_may_not(site: Site) -> None:
    """The robots of the other operator are named, and the own ones stopped."""
    code, output = invoke("stop", "--fleet", str(site.fleet_file("mate")))
    assert code == 1
    assert "r1  stopped" in output
    assert "does not grant stop of the robot to 'mate', which has the role observer there" in output


def test_a_robot_that_grants_nothing_says_so(site: Site) -> None:
    code, output = invoke("call", "r2", "Pose", "get_value", "--fleet", str(site.fleet_file("driver")))
    assert code != 0
    assert "the fleet file gives the certificate driver no role there" in output
