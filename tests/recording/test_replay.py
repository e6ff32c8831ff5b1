"""Replay of a record in place of its robots."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import (
    ConfigError,
    NotReadyError,
    ResourceFaultError,
    ResourceNotFoundError,
    RobotFailedError,
)
from eal_actors.managers.config import EALConfigManager
from eal_actors.recording import RunFolder, RunRecorder, compare_runs
from eal_actors.scenario import Run, load_scenario, make_plan
from tests.plugin_files import write_plugin
from tests.recording.conftest import record_run
from tests.scenario_texts import scenario_of


def replay_fleet(run: Path, **settings: Any) -> Fleet:
    plugins = {"replay": {"record": str(run), **settings}}
    robots = {name: {"plugins": plugins} for name in ("evbot3-1", "roomba-1")}
    return Fleet(
        EALConfigManager.of({"version": 1, "name": "sim", "seed": 3, "clock": {"rate": "max"}, "robots": robots}).fleet
    )


@pytest.fixture
def fleet(run: Path) -> Iterator[Fleet]:
    with replay_fleet(run).connect() as fleet:
        yield fleet


def test_a_scenario_runs_on_the_record_as_it_ran_on_the_robots(run: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "drive.yaml"
    text = (run / "scenario.yaml").read_text()
    scenario.write_text(text[: text.index("      - get_value")])  # a frame is not in the record at that very moment
    with replay_fleet(run).connect() as fleet:
        played = Run(make_plan(load_scenario(scenario), fleet), fleet, tmp_path / "again").start().get(timeout=60)
    real = RunFolder.open(run).summary
    assert real is not None
    assert played.outcome == "done"
    drives = [step for step in real.steps if step.kind == "send_cmd"]
    assert [(s.robot, s.command) for s in played.steps] == [(s.robot, s.command) for s in drives]
    assert [s.end_s for s in played.steps] == pytest.approx([s.end_s for s in drives], abs=1e-6)


def test_sensors_return_their_recorded_values(run: Path, fleet: Fleet) -> None:
    path = RunFolder.open(run).paths["roomba-1"]
    fleet.clock.sleep(path[15].time_s + 0.01)
    pose = fleet["roomba-1"]["TruePose"].get_value().get()
    assert pose.value == pytest.approx(path[15][1:], abs=1e-5)
    assert pose.stamp_s is not None
    assert fleet.clock.now() - pose.stamp_s == pytest.approx(0.01, abs=1e-3)


def test_another_command_than_the_recorded_one_is_refused(fleet: Fleet) -> None:
    with pytest.raises(ResourceFaultError, match=r"has 'f0\.2' as its command 1, not 'l90'"):
        fleet["roomba-1"]["Base"].send_cmd("l90").get()


WRITER = """\
from eal_actors.plugin import EALPlugin, Resource, ResourceType, command


class Lamp(Resource):
    types = ResourceType.ACTUATOR

    def halt(self):
        pass

    def set_value(self, data):
        yield 0.5

    def write_comm(self, data, length):
        return length

    @command("blink")
    def blink(self):
        yield 0.25
"""


def test_values_and_bytes_are_written_as_they_were(tmp_path: Path) -> None:
    write_plugin(tmp_path, "writer", WRITER, "Lamp")
    steps = ("set_value: {resource: Lamp, value: 1}", "send_cmd: {resource: Lamp, cmd: blink}")
    scenario = tmp_path / "write.yaml"
    scenario.write_text(
        scenario_of(*steps, "write_comm: {resource: Lamp, data: on}", "set_value: {resource: Lamp, value: 0}")
    )
    robots: dict[str, Any] = {"lamp": {"plugins": {"writer": {}}}}
    keys = {"version": 1, "name": "lamps", "clock": {"rate": "max"}}
    reports = []
    for name, fleet_keys in (
        ("real", {"plugin_dirs": [str(tmp_path / "plugins")], "robots": robots}),
        ("again", {"robots": {"lamp": {"plugins": {"replay": {"record": str(tmp_path / "real")}}}}}),
    ):
        directory = tmp_path / name
        directory.mkdir()
        with Fleet(EALConfigManager.of(keys | fleet_keys).fleet).connect() as fleet:
            recorder = RunRecorder(fleet, fleet, directory, "poses")
            run = Run(make_plan(load_scenario(scenario), fleet), fleet, directory, [recorder.hear])
            with recorder:
                reports.append(run.start().get(timeout=60))
    assert [report.outcome for report in reports] == ["done", "done"], reports[1].error
    assert [s.end_s for s in reports[1].steps] == pytest.approx([s.end_s for s in reports[0].steps], abs=1e-6)
    with (
        Fleet(EALConfigManager.of(keys | fleet_keys).fleet).connect() as fleet,
        pytest.raises(ResourceFaultError, match="has 'set_value' as its command 1, not 'blink'"),
    ):
        fleet["lamp"]["Lamp"].send_cmd("blink").get()


def test_the_error_about_a_sensor_that_is_not_recorded_names_the_option_that_records_it(tmp_path: Path) -> None:
    run = record_run(tmp_path / "poses" / "run", "poses")
    scenario = tmp_path / "wait.yaml"
    scenario.write_text(scenario_of("{wait_until: value('Range') > 0, timeout_s: 1}", role="all"))
    sensors = r"unknown resource 'Range'.*; left out: the record lacks Odometry, .*Range, .*, which `--record sensors`"
    with replay_fleet(run).connect() as fleet:
        with pytest.raises(ConfigError, match=f"evbot3-1: {sensors}"):
            make_plan(load_scenario(scenario), fleet)
        with pytest.raises(ResourceNotFoundError, match=sensors):
            fleet["evbot3-1"]["Range"]
        assert not fleet.problems
    with (
        replay_fleet(run, robot="evbot2-1").connect() as fleet,
        pytest.raises(ResourceNotFoundError, match="the record lacks Camera, which `--record all` records"),
    ):
        fleet["evbot3-1"]["Camera"]


def test_at_its_end_the_robots_are_not_ready(fleet: Fleet) -> None:
    fleet.clock.sleep(100.0)
    with pytest.raises(NotReadyError, match="the record ended at"):
        fleet["roomba-1"]["Pose"].get_value().get()


def test_a_looped_replay_starts_again(run: Path) -> None:
    with replay_fleet(run, loop=True).connect() as fleet:
        fleet.clock.sleep(100.0)
        assert len(fleet["roomba-1"]["Pose"].get_value().get().value) == 3


def test_a_robot_that_is_not_in_the_record_is_refused_with_the_valid_names(run: Path) -> None:
    with replay_fleet(run, robot="evbot2-9").connect() as fleet, pytest.raises(RobotFailedError, match="has no robot"):
        fleet["roomba-1"].require_started()


def test_a_run_does_not_differ_from_itself(run: Path) -> None:
    assert list(compare_runs(RunFolder.open(run), RunFolder.open(run))) == []
