"""The content of `run.mcap` of a real run, and its repeatability."""

from __future__ import annotations

import csv
import dataclasses
import errno
import json
import math
import resource
import shutil
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from eal_actors.actors.combine import gather
from eal_actors.cli.app import app
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel import posix
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError, ScenarioError
from eal_actors.kernel.lock_step import MAX
from eal_actors.managers.config import EALConfigManager
from eal_actors.recording import (
    RunFolder,
    RunRecorder,
    messages,
    new_run_folder,
    repair_interrupted,
    repair_record,
    schemas,
)
from eal_actors.recording.mcap_file import RECORD_FILE, McapFile, read_mcap
from eal_actors.recording.recorded_run import INFOS, RecordedRun
from eal_actors.recording.repair import PART_FILE, merge_record
from eal_actors.scenario.report.events import LogLine, RunContinued, RunStarted
from eal_actors.scenario.report.journal import Journal, hold_record
from tests.recording.conftest import record_run


def poses(run: Path, robot: str) -> list[tuple[float, float, float, float]]:
    with (run / "trajectory.csv").open() as table:
        return [
            (float(row["time_s"]), float(row["x_m"]), float(row["y_m"]), float(row["yaw_rad"]))
            for row in csv.DictReader(table)
            if row["robot"] == robot
        ]


def test_the_poses_of_the_record_are_those_of_the_trajectory(run: Path) -> None:
    recorded = RecordedRun.open(run / "run.mcap")
    wanted = poses(run, "roomba-1")
    assert len(wanted) > 20
    for time_s, *pose in wanted:
        value = recorded.value_at("roomba-1", "TruePose", time_s + 0.001)
        assert value is not None
        assert value.value == pytest.approx(pose, abs=1e-5)


def test_messages_are_stamped_in_the_time_of_the_run(run: Path) -> None:
    entries = read_mcap(run / "run.mcap").messages
    last_s = max(entry.time_s for entry in entries)
    end_s = poses(run, "roomba-1")[-1][0]
    assert min(entry.time_s for entry in entries) == 0.0
    assert last_s == pytest.approx(end_s, abs=0.2)


def test_the_record_has_transforms_scans_frames_calls_and_the_arena(run: Path) -> None:
    entries = read_mcap(run / "run.mcap").messages
    schema_of = {entry.topic: entry.schema for entry in entries}
    assert schema_of["/tf"] == "foxglove.FrameTransforms"
    assert schema_of["/arena"] == "foxglove.SceneUpdate"
    assert schema_of["/log"] == "foxglove.Log"
    assert schema_of["/roomba-1/Pose"] == schema_of["/roomba-1/TruePose"] == "foxglove.PoseInFrame"
    assert schema_of["/roomba-1/Range"] == "foxglove.LaserScan"
    assert schema_of["/roomba-1/Camera"] == "foxglove.CompressedImage"
    assert schema_of["/roomba-1/Bump"] == "eal.Value"
    commands = [entry.message for entry in entries if entry.topic == "/evbot3-1/commands"]
    assert [command["command"] for command in commands] == ["f0.2", "l90", ""]
    assert all(command["outcome"] == "done" for command in commands)


def test_the_arena_has_every_field_that_foxglove_requires_of_an_entity(run: Path) -> None:
    (entity,) = next(e.message["entities"] for e in read_mcap(run / "run.mcap").messages if e.topic == "/arena")
    assert set(entity) == {
        *("timestamp", "frame_id", "id", "lifetime", "frame_locked", "metadata", "arrows", "cubes", "spheres"),
        *("cylinders", "lines", "triangles", "texts", "models"),
    }


def test_transforms_follow_the_heading_of_the_robot(run: Path) -> None:
    entries = read_mcap(run / "run.mcap").messages
    turns = [
        transform["rotation"]
        for entry in entries
        if entry.topic == "/tf"
        for transform in entry.message["transforms"]
        if transform["child_frame_id"] == "roomba-1/base"
    ]
    yaw_rad = 2 * math.atan2(turns[-1]["z"], turns[-1]["w"])
    assert yaw_rad == pytest.approx(math.pi / 2, abs=0.1)


def test_an_image_can_be_read_back(run: Path) -> None:
    recorded = RecordedRun.open(run / "run.mcap")
    frame = recorded.value_at("roomba-1", "Camera", recorded.duration_s)
    assert frame is not None
    assert frame.shape is not None
    assert frame.shape[2] == 3
    assert frame.value.std() > 1.0


def test_two_runs_of_one_seed_leave_the_same_messages(tmp_path: Path) -> None:
    first, second = (read_mcap(record_run(tmp_path / name / "run", "sensors") / "run.mcap") for name in ("one", "two"))
    assert first.messages == second.messages
    assert first.attachments == second.attachments


def test_other_readers_see_the_date_of_the_run(run: Path) -> None:
    """Times of logs, messages and transforms, by the library's own reader; at `rate: max` they run ahead."""
    with (run / "run.mcap").open("rb") as stream:
        entries = [
            (message.log_time / 1e9, json.loads(message.data)) for _, _, message in make_reader(stream).iter_messages()
        ]
    today_s = wall_time().timestamp()
    for log_s, message in entries:
        stamps = [part["timestamp"]["sec"] for part in (message, *message.get("transforms", ())) if "timestamp" in part]
        assert all(abs(today_s - time_s) < 3600 for time_s in (log_s, *stamps))


def test_each_robot_has_a_hull_in_its_own_frame(run: Path) -> None:
    (hulls,) = (entry.message for entry in read_mcap(run / "run.mcap").messages if entry.topic == "/robots")
    radius_m = {entity["frame_id"]: entity["cylinders"][0]["size"]["x"] / 2 for entity in hulls["entities"]}
    assert set(radius_m) == {"evbot2-1/base", "evbot3-1/base", "roomba-1/base"}
    assert all(0.1 < radius < 0.3 for radius in radius_m.values())


def test_a_killed_record_is_repaired_for_every_reader(run: Path, tmp_path: Path) -> None:
    killed = shutil.copytree(run, tmp_path / "killed")
    whole = (killed / "run.mcap").read_bytes()
    (killed / "run.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    with (killed / "run.mcap").open("rb") as stream, pytest.raises(Exception, match=r"."):
        list(make_reader(stream).iter_messages())
    for answer in ("repaired", "is whole"):
        done = CliRunner().invoke(app, ["records", "repair", str(killed)])
        assert done.exit_code == 0, done.output
        assert answer in done.output
    with (killed / "run.mcap").open("rb") as stream:
        topics = [channel.topic for _, channel, _ in make_reader(stream).iter_messages()]
    whole_topics = [entry.topic for entry in read_mcap(run / "run.mcap").messages]
    for topic in ("/events", "/tf", "/roomba-1/commands"):
        assert topics.count(topic) == whole_topics.count(topic)


def test_a_record_that_found_no_room_for_a_while_is_whole_at_its_end(tmp_path: Path) -> None:
    config = dataclasses.replace(EALConfigManager.load(bundled_path("fleets/sim.yaml")).fleet, rate=MAX)
    plain, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Fleet(config) as fleet, RunRecorder(fleet, ["roomba-1"], tmp_path, "all") as made:
        journal = Journal(tmp_path, [made.hear])
        about: dict[str, Any] = dict.fromkeys(
            ("scenario", "scenario_file", "scenario_hash", "fleet", "fleet_file"), "x"
        )
        about |= {"roles": {}, "spares": {}, "parameters": {}, "calls": 0, "seed": 0, "rate": 1.0}
        journal.write(RunStarted(0.0, robots=("roomba-1",), **about))
        resource.setrlimit(resource.RLIMIT_FSIZE, (70_000, most))  # acts like a full disk
        try:
            fleet.clock.sleep(3.0)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (plain, most))
        journal.write(LogLine(3.0, None, "the end"))
        journal.close()
    content = read_mcap(tmp_path / RECORD_FILE)
    assert content.is_complete
    assert [entry.message["event"] for entry in content.messages if entry.topic == "/events"] == ["run_started", "log"]
    newest_s = max(entry.time_s for entry in content.messages if entry.topic == "/roomba-1/TruePose")
    assert newest_s == pytest.approx(3.0, abs=0.2)


def test_the_next_run_repairs_the_records_of_killed_runs_and_of_no_others(run: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    half = (run / "run.mcap").read_bytes()[:-2000]
    for name in ("killed", "under-way", "damaged"):
        shutil.copytree(run, runs / name)
        (runs / name / "run.mcap").write_bytes(half if name != "damaged" else b"no record at all, but long enough")
        (runs / name / "summary.json").unlink()
    with hold_record(runs / "under-way"):
        with pytest.raises(ScenarioError, match="is under way: another process writes its record"):
            repair_record(runs / "under-way")
        scenario = tmp_path / "log.yaml"
        scenario.write_text(
            "version: 1\nname: log\nroles: {all: {}}\nsteps: [{on: all, do: [{log: done}]}]\n", encoding="utf-8"
        )
        done = CliRunner().invoke(app, ["run", str(scenario), "--fleet", "sim", "--runs-dir", str(runs)])
    assert done.exit_code == 0, done.output
    assert (runs / "under-way" / "run.mcap").read_bytes() == half
    assert RunFolder.open(runs / "killed").record.is_complete
    with (runs / "killed" / "run.mcap").open("rb") as stream:
        assert list(make_reader(stream).iter_messages())


def test_where_there_are_no_locks_a_record_is_repaired_only_if_that_is_asked_for(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody can tell whether another process writes it."""

    def refuse(_stream: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    killed = shutil.copytree(run, tmp_path / "runs" / "killed")
    (killed / "run.mcap").write_bytes((run / "run.mcap").read_bytes()[:-2000])
    (killed / "summary.json").unlink()
    monkeypatch.setattr(posix, "lock", refuse)
    assert repair_interrupted(tmp_path / "runs") == []
    repair_record(killed)
    assert RunFolder.open(killed).record.is_complete


def test_a_merge_that_a_crash_cut_short_adds_nothing_twice(run: Path, tmp_path: Path) -> None:
    merged = shutil.copytree(run, tmp_path / "merged")
    shutil.copy(merged / RECORD_FILE, merged / PART_FILE)  # merged already, but not removed yet
    repair_record(merged)
    assert read_mcap(merged / RECORD_FILE).messages == read_mcap(run / RECORD_FILE).messages
    assert not (merged / PART_FILE).exists()


def test_a_repair_that_fails_names_the_line_and_leaves_no_file(run: Path, tmp_path: Path) -> None:
    broken = shutil.copytree(run, tmp_path / "broken")
    (broken / "trajectory.csv").write_text("robot,time_s,x_m,y_m,yaw_rad\nroomba-1,0,0,0,0\nroomba-1,1,x,0,0\n")
    before = sorted(broken.iterdir())
    with pytest.raises(ScenarioError, match=r"trajectory\.csv:3: is no table of paths"):
        merge_record(RunFolder.open(broken))
    assert sorted(broken.iterdir()) == before
    (broken / "trajectory.csv").write_text("robot,time_s\n" + "x" * 200_000 + "\n")
    with pytest.raises(ScenarioError, match=r"trajectory\.csv:\d: is no table of paths"):
        _ = RunFolder.open(broken).paths


def test_what_a_tracker_finds_after_the_end_is_left_out(tmp_path: Path) -> None:
    config = EALConfigManager.load(bundled_path("fleets/sim.yaml")).fleet
    with Fleet(dataclasses.replace(config, rate=MAX)).connect(["roomba-1"]) as fleet:
        recorder = RunRecorder(fleet, fleet, tmp_path)
        with recorder:
            recorder.hear(RunContinued(0.0, 1, "", "round", "sim", ("roomba-1",), 3))
            log = fleet.services.picture_log
        assert log is not None
        log.add("camera", fleet.clock.now(), {"text": "x" * 100_000})
    assert not [entry for entry in read_mcap(tmp_path / RECORD_FILE).messages if entry.topic == "/pictures"]


def test_a_frame_without_content_is_invalid(tmp_path: Path) -> None:
    file = McapFile(tmp_path / RECORD_FILE)
    file.attach(INFOS, {})
    file.write("/r/Camera", schemas.IMAGE, 0.0, messages.image_message(0.0, "r", b""))
    file.close()
    with pytest.raises(ScenarioError, match=r"the record's value at 0\.000 s is invalid: .*a frame is no image"):
        RecordedRun.open(tmp_path / RECORD_FILE).value_at("r", "Camera", 1.0)


def test_a_folder_of_runs_on_a_disk_that_is_absent_is_reported(tmp_path: Path) -> None:
    (tmp_path / "runs").symlink_to(tmp_path / "absent" / "disk")
    with pytest.raises(ConfigError, match=r"runs: cannot be made: File exists"):
        new_run_folder(tmp_path / "runs", "x")


def test_sampling_does_not_change_the_paths(tmp_path: Path, run: Path) -> None:
    blind = record_run(tmp_path / "blind" / "run", "poses")
    assert (blind / "trajectory.csv").read_bytes() == (run / "trajectory.csv").read_bytes()


def test_the_readable_part_of_a_torn_record_is_read(run: Path, tmp_path: Path) -> None:
    whole = (run / "run.mcap").read_bytes()
    torn = tmp_path / "run.mcap"
    torn.write_bytes(whole[: len(whole) // 2])
    content = read_mcap(torn)
    assert not content.is_complete
    assert content.messages == read_mcap(run / "run.mcap").messages[: len(content.messages)]
    assert content.messages


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    file.write_bytes(b"certainly not an MCAP file, but long enough to be taken for one")
    with pytest.raises(ScenarioError, match=r"run\.mcap is no record of a run"):
        read_mcap(file)


def test_images_that_the_scenario_reads_are_recorded_in_any_extent(tmp_path: Path) -> None:
    directory = record_run(tmp_path / "one" / "run", "poses")
    frames = [entry for entry in read_mcap(directory / "run.mcap").messages if entry.topic.endswith("/Camera")]
    assert sorted(frame.topic for frame in frames) == ["/evbot3-1/Camera", "/roomba-1/Camera"]
    assert {frame.schema for frame in frames} == {"foxglove.CompressedImage"}
    assert '"answer"' not in (directory / "events.jsonl").read_text(encoding="utf-8")


def test_poses_of_a_resumed_run_are_recorded(tmp_path: Path) -> None:
    config = EALConfigManager.load(bundled_path("fleets/sim.yaml")).fleet
    with Fleet(dataclasses.replace(config, rate=MAX)).connect() as fleet:
        recorder = RunRecorder(fleet, fleet, tmp_path)
        with recorder:
            recorder.hear(RunContinued(30.0, 1, "", "round", "sim", ("roomba-1",), 3))
            fleet.clock.sleep(1.0)
    times_s = [entry.time_s for entry in read_mcap(tmp_path / "run.mcap").messages if entry.topic == "/roomba-1/Pose"]
    assert len(times_s) > 5
    assert max(times_s) == pytest.approx(31.0, abs=0.2)


def test_robots_of_drivers_leave_a_trajectory_by_their_estimated_pose(tmp_path: Path) -> None:
    """The real drivers at their emulators, without a resource of the simulation."""
    drivers = {
        "evbot2-1": {"evbot2": {"port": "sim://world"}},
        "evbot3-1": {"evbot3": {"address": "sim://world"}},
        "roomba-1": {"roomba": {"protocol": "sci", "port": "sim://world"}},
    }
    robots = {
        name: {"plugins": plugins, "pose": {"start": {"x_m": float(place), "y_m": 2.0}}}
        for place, (name, plugins) in enumerate(drivers.items())
    }
    config = EALConfigManager.of({"version": 1, "clock": {"rate": "max"}, "robots": robots}).fleet
    with Fleet(config) as fleet:
        recorder = RunRecorder(fleet, fleet, tmp_path)
        with recorder:
            recorder.hear(RunContinued(0.0, 1, "", "drive", "drivers", tuple(drivers), 3))
            gather([robot["Base"].send_cmd("f0.2") for robot in fleet.values()]).get()
    topics = {entry.topic for entry in read_mcap(tmp_path / "run.mcap").messages}
    for place, name in enumerate(drivers):
        path = poses(tmp_path, name)
        assert len(path) > 5, name
        _, *first = path[0]
        _, *last = path[-1]
        assert first == pytest.approx([place, 2.0, 0.0], abs=0.01), name
        assert last == pytest.approx([place + 0.2, 2.0, 0.0], abs=0.03), name
        assert f"/{name}/Pose" in topics
        assert f"/{name}/TruePose" not in topics
