from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from eal_actors.device.data import EALData
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import ScaledClock
from eal_actors.kernel.lock_step import MAX
from eal_actors.managers.config import EALConfigManager
from eal_actors.recording import (
    PoseRecorder,
    PoseSample,
    RunFolder,
    RunRecorder,
    draw_trajectory,
    film_run,
    keep_provenance,
    messages,
    picture,
    schemas,
)
from eal_actors.recording.mcap_file import McapFile, read_mcap
from eal_actors.recording.picture import tick_quarter_turns
from eal_actors.recording.poses import TrajectoryTable
from eal_actors.recording.provenance import kept_scenario
from eal_actors.scenario import Run, load_scenario, make_plan
from tests.figures import keep_figures
from tests.patience import patient_fleet
from tests.plugin_files import write_plugin

PLUGIN = """\
from eal_actors.plugin import EALPlugin, PluginError, PluginSettingsModel, Resource, ResourceType, command


class Settings(PluginSettingsModel):
    answer: str = "[1, 2.5, 0]"
    is_broken: bool = False


class Pose(Resource):
    types = ResourceType.SENSOR

    def __init__(self, settings):
        self.settings = settings

    def get_value(self):
        return eval(self.settings.answer, {"inf": float("inf")})


class Clock(Resource):
    types = ResourceType.OTHER

    @command("pass")
    def let_pass(self):
        yield 1.0


def connect(context):
    if context.settings.is_broken:
        raise PluginError("unplugged")
    return EALPlugin("Pose", "Clock")


def create_Pose(context):
    return Pose(context.settings)
"""


def posers(folder: Path, **robots: Mapping[str, object]) -> Fleet:
    """Return a fleet of robots that answer as their settings say."""
    write_plugin(folder, "poser", PLUGIN, "Pose", "Clock")
    lines = "".join(f"  {name}: {{plugins: {{poser: {json.dumps(given)}}}}}\n" for name, given in robots.items())
    (folder / "fleet.yaml").write_text(f"version: 1\nname: posers\nplugin_dirs: [plugins]\nrobots:\n{lines}")
    config = EALConfigManager.load(folder / "fleet.yaml", environment={}).fleet
    return Fleet(config, ScaledClock(20.0))


def record_more(recorder: PoseRecorder, fleet: Fleet, robot: str) -> None:
    """Let time pass until the robot's path has two more samples."""
    wanted = len(recorder.paths_since(0.0)[robot]) + 2
    while len(recorder.paths_since(0.0)[robot]) < wanted:
        fleet[robot]["Clock"].send_cmd("pass", timeout_s=1000).get()


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        ("[1, 2]", "must be double (3), not of shape (2,)"),
        ("[1, 2, 3, 4]", "must be double (3), not of shape (4,)"),
        ("'abc'", "must be double (3), not 'abc'"),
        ("5", "must be double (3), not of shape ()"),
        ("None", "must be double (3), not None"),
        ("[1.0, inf, 0.0]", "must be finite, not"),
    ],
)
def test_an_invalid_pose_ends_the_path_of_its_robot_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], answer: str, problem: str
) -> None:
    with posers(tmp_path, odd={"answer": answer}, sound={}) as fleet, PoseRecorder(fleet, fleet) as recorder:
        record_more(recorder, fleet, "sound")
        record_more(recorder, fleet, "sound")
    paths = recorder.paths_since(0.0)

    assert paths["odd"] == []
    assert {sample[1:] for sample in paths["sound"]} == {(1.0, 2.5, 0.0)}
    warnings = [line for line in capsys.readouterr().err.splitlines() if "the path is no longer recorded" in line]
    assert len(warnings) == 1
    assert "odd" in warnings[0]
    assert f"the value of its Pose {problem}" in warnings[0]


def test_robots_that_fail_or_have_no_pose_are_skipped(tmp_path: Path) -> None:
    with (
        posers(tmp_path, broken={"is_broken": True}, raising={"answer": "1 / 0"}, leaving={}, sound={}) as fleet,
        PoseRecorder(fleet, fleet) as recorder,
    ):
        record_more(recorder, fleet, "leaving")
        fleet["leaving"].close()
        record_more(recorder, fleet, "sound")
    paths = recorder.paths_since(0.0)

    assert set(paths) == {"raising", "leaving", "sound"}
    assert paths["raising"] == []
    assert len(paths["leaving"]) >= 2
    assert len(paths["sound"]) >= 2


def test_times_in_the_table_count_from_the_start_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(
        "version: 1\nname: s\ndescription: d\nroles: {all: {}}\n"
        "steps: [{wait_s: 1}, {on: all, do: [{send_cmd: {resource: Base, cmd: g}}]}]\n"
    )
    with patient_fleet(bundled_path("fleets/sim.yaml"), rate=MAX) as fleet:
        recorder = RunRecorder(fleet, fleet, tmp_path)
        run = Run(make_plan(load_scenario(tmp_path / "s.yaml"), fleet), fleet, listeners=[recorder.hear])
        with recorder:
            for robot in fleet.values():
                robot["Base"].send_cmd("r30").get()  # what is before the run belongs to no run
            fleet.clock.sleep(0.5)  # the last sample before the run shows them at rest
            report = run.start().get()

    with (tmp_path / "trajectory.csv").open(encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table))
    for step in (step for step in report.steps if step.is_call):
        times_s = [float(row["time_s"]) for row in rows if row["robot"] == step.robot]
        poses = [(row["x_m"], row["y_m"]) for row in rows if row["robot"] == step.robot]
        moved = next(number for number, pose in enumerate(poses) if pose != poses[0])
        assert times_s == sorted(times_s)
        assert times_s[0] == 0.0
        assert times_s[-1] <= report.duration_s + 20.0, "it looks once more after the end: within a real second"
        assert 1.0 <= step.start_s < times_s[moved]
        assert times_s[moved - 1] < step.end_s


def test_a_path_begins_with_the_last_sample_before_the_start(tmp_path: Path) -> None:
    with posers(tmp_path, sound={}) as fleet, PoseRecorder(fleet, fleet) as recorder:
        record_more(recorder, fleet, "sound")
        start_s = fleet.clock.now()
        record_more(recorder, fleet, "sound")
    raw = [sample.time_s for sample in recorder.paths_since(0.0)["sound"]]
    path = recorder.paths_since(start_s)["sound"]

    assert [sample.time_s for sample in path] == [0.0, *(time_s - start_s for time_s in raw if time_s > start_s)]


def test_numbers_in_the_table_are_rounded(tmp_path: Path) -> None:
    path = [PoseSample(0.0, 1.0, -1e-9, math.pi), PoseSample(0.10049999, 1 / 3, 12.5, -math.pi)]
    table = TrajectoryTable(tmp_path / "t.csv")
    for sample in path:
        table.add("a", sample)
    table.close()

    assert (tmp_path / "t.csv").read_text().splitlines() == [
        "robot,time_s,x_m,y_m,yaw_rad",
        "a,0.000,1.000000,0.000000,3.141593",
        "a,0.100,0.333333,12.500000,-3.141593",
    ]


def test_the_picture_marks_robots_that_failed_or_were_dropped(tmp_path: Path) -> None:
    from matplotlib.image import imread

    turns = 40 * math.pi
    paths = {
        name: [PoseSample(time_s, time_s / 10, y_m, (time_s / 20 * turns) % math.pi) for time_s in range(21)]
        for name, y_m in (("a", 0.0), ("b", 1.0))
    }
    paths["silent"] = []
    plain, lost, done = (tmp_path / f"{name}.png" for name in ("plain", "lost", "done"))
    assert draw_trajectory(paths, None, plain, "title") == plain
    draw_trajectory(paths, None, lost, "title", {"a": "dropped", "b": "done", "silent": "failed"})
    draw_trajectory(paths, None, done, "title", {"a": "done", "b": "aborted"})

    assert np.array_equal(imread(plain), imread(done))
    assert imread(plain).shape == imread(lost).shape
    assert not np.array_equal(imread(plain), imread(lost))


def test_robots_that_stay_at_the_origin_are_drawn_with_their_headings(tmp_path: Path) -> None:
    east, north = tmp_path / "east.png", tmp_path / "north.png"
    for yaw_rad, file in ((0.0, east), (math.pi / 2, north)):
        paths = {"a": [PoseSample(time_s / 10, 0.0, 0.0, yaw_rad) for time_s in range(20)]}
        draw_trajectory(paths, None, file, "title")
    assert east.read_bytes() != north.read_bytes()


def test_eight_robots_have_eight_colours_and_markers_and_a_cross_is_where_it_happened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures = keep_figures(monkeypatch, picture)
    names = [f"robot-{number}" for number in range(8)]
    paths = {
        name: [PoseSample(time_s / 2, time_s, y_m, time_s / 10) for time_s in range(41)]
        for y_m, name in enumerate(names)
    }
    draw_trajectory(paths, None, tmp_path / "all.png", "title", {"robot-3": "dropped"}, lost_s={"robot-3": 5.2})
    arena, headings = figures[0].axes
    ends = [line for line in arena.lines if line.get_label() in (*names, "robot-3 (dropped)")]
    assert len({line.get_color() for line in ends}) == len({line.get_marker() for line in ends}) == 8
    crosses = [line for axes in (arena, headings) for line in axes.lines if line.get_marker() == "x"]
    places = [number for line in crosses for number in np.ravel(line.get_xydata())]
    assert places == pytest.approx([10.0, 3.0, 5.0, math.degrees(1.0)])
    assert (arena.get_xlabel(), headings.get_xlabel(), arena.get_aspect()) == ("x [m]", "fleet time [s]", 1.0)
    assert len(arena.collections) == 8  # small arrows: the headings along each path


@pytest.mark.parametrize(
    ("range_deg", "expected"),
    [((-10.0, 10.0), [0]), ((-365.0, 5.0), [-360, -270, -180, -90, 0]), ((0.0, 3600.0), range(0, 3601, 720))],
)
def test_ticks_of_headings_are_quarter_turns_apart(range_deg: tuple[float, float], expected: list[int]) -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    axes.set_ylim(*range_deg)
    tick_quarter_turns(axes)

    low_deg, high_deg = range_deg
    assert [tick for tick in axes.get_yticks() if low_deg <= tick <= high_deg] == list(expected)


def test_a_straight_path_of_kilometres_has_a_film(tmp_path: Path) -> None:
    (tmp_path / "trajectory.csv").write_text("robot,time_s,x_m,y_m,yaw_rad\na,0,0,0,0\na,900,3000,0,0\n")
    film = film_run(RunFolder(tmp_path), None)
    assert film is not None
    with Image.open(film) as opened:
        assert opened.size == (560, 1)


def test_a_kept_scenario_finds_those_that_it_runs_whatever_its_suffix(tmp_path: Path) -> None:
    head = "version: 1\nname: x\nroles: {all: {}}\nsteps:\n"
    (tmp_path / "top.yml").write_text(f"{head}- scenario: part.yml\n")
    (tmp_path / "part.yml").write_text(f"{head}- on: all\n  do: [{{log: x}}]\n")
    run = tmp_path / "run"
    run.mkdir()
    keep_provenance(run, Fleet.load("sim").config, load_scenario(tmp_path / "top.yml"))
    assert load_scenario(kept_scenario(run)).size == 3


def test_a_topic_whose_values_become_of_another_kind_has_a_channel_for_each(tmp_path: Path) -> None:
    """A reader takes a message for one of its channel's schema."""
    file = McapFile(tmp_path / "run.mcap")
    scan = messages.scan_message(0.0, "a", [1.0, 2.0], [0.0, 1.0])
    file.write("/a/Lidar", schemas.SCAN, 0.0, scan)
    file.write("/a/Lidar", schemas.VALUE, 1.0, messages.value_message(1.0, EALData.of([1.0, 2.0, 3.0])))
    file.write("/a/Lidar", schemas.SCAN, 2.0, scan)
    file.close()
    found = read_mcap(tmp_path / "run.mcap").messages
    assert [message.schema for message in found] == [schemas.SCAN.name, schemas.VALUE.name, schemas.SCAN.name]
