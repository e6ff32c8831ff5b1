"""A folder of frames: their order, their yaws, `eal stitch`, and the step of a scenario."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from eal_actors.kernel.errors import ConfigError, ScenarioError
from eal_actors.lab.panorama.folder import read_frames
from eal_actors.lab.panorama.step import stitch_run
from tests.program import run_eal
from tests.unit.lab.contexts import step_context
from tests.unit.lab.panorama.turning import Image, noisy, shots, steps

TRUE = noisy(steps(3), seed=1)


def save(folder: Path, frames: Sequence[Image], suffix: str = ".png", first: int = 0) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(frames, first):
        assert cv2.imwrite(str(folder / f"frame.{number}{suffix}"), frame[..., ::-1])
    return folder


def save_poses(folder: Path, yaws_rad: Sequence[float]) -> None:
    for number, yaw_rad in enumerate(yaws_rad):
        (folder / f"frame.{number}.json").write_text(json.dumps([0.1, 0.2, yaw_rad]))


def tiny(number: int) -> list[Image]:
    return [np.full((40, 60, 3), 10 * level, np.uint8) for level in range(number)]


def load(file: Path) -> Image:
    picture = cv2.imread(str(file))
    assert picture is not None
    return np.asarray(picture, np.uint8)


# Reading.


def test_frames_come_in_natural_order_as_rgb(tmp_path: Path) -> None:
    frames = tiny(12)
    frames[10][:] = (255, 0, 0)
    found = read_frames(save(tmp_path, frames), step_rad=0.5)
    assert found.names == tuple(f"frame.{number}.png" for number in range(12))
    assert tuple(found.images[10][0, 0]) == (255, 0, 0)
    assert found.yaws_rad[:3] == (0, -0.5, -1.0)


def test_other_files_and_panoramas_are_no_frames(tmp_path: Path) -> None:
    save(tmp_path, tiny(2))
    for name in ("panorama.png", "wide.png", ".hidden.png", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    assert len(read_frames(tmp_path, 0.5, [tmp_path / "wide.png"]).names) == 2


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ("yaws.csv", "yaw_rad\n0.5\n0.25\n"),
        ("yaws.csv", "time_s,x_m,y_m,yaw_rad\n1,0,0,0.5\n2,0,0,0.25\n"),
        ("frames.csv", f"file, yaw_deg\nframe.1.png, {math.degrees(0.25)}\nframe.0, {math.degrees(0.5)}\n"),
    ],
)
def test_yaws_come_from_a_table(tmp_path: Path, table: str, text: str) -> None:
    save(tmp_path, tiny(2))
    (tmp_path / table).write_text(text)
    assert read_frames(tmp_path).yaws_rad == pytest.approx((0.5, 0.25))


def test_yaws_come_from_the_poses_beside_the_frames(tmp_path: Path) -> None:
    save_poses(save(tmp_path, tiny(2)), [0.5, 0.25])
    assert read_frames(tmp_path).yaws_rad == (0.5, 0.25)


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({}, r"no yaws.csv, frames.csv or frame.0.json. Give the angle between frames \(--step\)"),
        ({"yaws.csv": "yaw\n1\n2\n"}, r"yaws.csv:1:1: needs a column yaw_rad or yaw_deg; it has yaw"),
        ({"yaws.csv": ""}, r"needs a column yaw_rad or yaw_deg; it has none"),
        ({"yaws.csv": "yaw_rad\n1\n"}, r"has 1 rows for 2 frames; name them in a column `file`"),
        ({"yaws.csv": "yaw_rad\n1\nleft\n"}, r"yaws.csv:3:1: yaw_rad must be a number, not 'left'"),
        ({"yaws.csv": "yaw_rad\n1\n\udcff2\n"}, r"yaws.csv:3:1: yaw_rad must be a number, not '\ufffd2'"),
        ({"yaws.csv": "yaw_rad\n1\n" + "2" * 200_000 + "\n"}, r"yaws.csv:\d:1: is no table: field larger than"),
        ({"yaws.csv": "yaw_rad\n1\nnan\n"}, r"yaws.csv:3:1: yaw_rad must be a number, not 'nan'"),
        ({"frames.csv": "file,yaw_rad\nframe.0.png,1\n"}, r"has no row for frame.1.png"),
        ({"frames.csv": "file,yaw_rad\nframe.0,1\nframe.0,2\nframe.1,2\n"}, r"frame.0 is repeated"),
        ({"frame.0.json": "[0, 0, 1]"}, r"frame.1.png: has no frame.1.json beside it"),
        ({"frame.0.json": "[0, 0, 1]", "frame.1.json": "[0, 0]"}, r"frame.1.json: must be a pose"),
        ({"yaws.csv": "yaw_rad\n1\n2\n", "frame.1.png": "no picture"}, r"frame.1.png: cannot be read as a picture"),
        ({"yaws.csv": "yaw_rad\n1\n2\n", "frame.1.png": ""}, r"frame.1.png: cannot be read as a picture"),
    ],
)
def test_what_is_wrong_with_a_folder_is_told(tmp_path: Path, files: Mapping[str, str], message: str) -> None:
    save(tmp_path, tiny(2))
    for name, text in files.items():
        (tmp_path / name).write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(ConfigError, match=message):
        read_frames(tmp_path)


def test_a_folder_of_folders_tells_where_the_frames_are(tmp_path: Path) -> None:
    save(tmp_path / "rover", tiny(2))
    with pytest.raises(ConfigError, match=r"holds no frames, .*; found in its folder rover"):
        read_frames(tmp_path)
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        read_frames(tmp_path / "nowhere")


# The command.


def test_eal_stitch_makes_a_panorama_and_tells_of_each_frame(tmp_path: Path) -> None:
    save(tmp_path, shots(TRUE))
    result = run_eal("stitch", tmp_path, "--step", "45")
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines() if line.startswith("frame.")]
    assert [row[0] for row in rows] == ["frame.0.png", "frame.1.png", "frame.2.png"]
    assert [row[4] for row in rows] == ["features"] * 3
    height, width, _ = load(tmp_path / "panorama.png").shape
    assert f"{width} x {height} px, 15" in result.stdout
    again = run_eal("stitch", tmp_path, "--step", "45", "--json")
    assert len(json.loads(again.stdout)["frames"]) == 3, "its own panorama is no frame"


def test_eal_stitch_finds_the_robots_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").write_text("")
    (tmp_path / "trajectory.png").write_text("no frame")
    result = run_eal("stitch", tmp_path, "--step", "45")
    assert result.exit_code == 2
    assert "is a run in which no robot saved .png" in result.output.replace("\n", " ")
    for robot in ("rover", "scout"):
        save(tmp_path / robot, shots(TRUE))
    (tmp_path / "logs").mkdir()
    result = run_eal("stitch", tmp_path, "--step", "45", "--json")
    assert (result.exit_code, sorted(json.loads(result.stdout))) == (0, ["rover", "scout"])
    load(tmp_path / "rover" / "panorama.png")
    load(tmp_path / "scout" / "panorama.png")
    assert "names one file, and the robots" in run_eal("stitch", tmp_path, "--out", "x.png").output


def test_eal_stitch_names_what_it_leaves_out_and_fails(tmp_path: Path) -> None:
    frames = shots(TRUE)
    frames[2] = np.zeros_like(frames[2])
    out = tmp_path / "kept" / "wide.jpg"
    result = run_eal("stitch", save(tmp_path, frames, ".jpg"), "--step", "45", "--out", out, "--json")
    assert result.exit_code == 1
    last = json.loads(result.stdout)["frames"][2]
    assert last["left_out"] == "is blank, but frame.1.jpg beside it is not"
    assert last["yaw_deg"] is None
    load(out)
    assert "left out: is blank" in run_eal("stitch", tmp_path, "--step", "45", "--out", out).stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "has no yaws"),
        (["--step", "45", "--field-of-view", "50"], "needs a field of view of 55 degrees"),
        (["--step", "45", "--out", "wide.gif"], "must end in .png, .jpg, .jpeg"),
        (["--step", "270"], "equal to 180"),
    ],
)
def test_eal_stitch_refuses_what_cannot_be(tmp_path: Path, options: list[str], message: str) -> None:
    result = run_eal("stitch", save(tmp_path, tiny(2)), *options)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert not (tmp_path / "panorama.png").exists()


# The step.


ROBOTS = {"rover": None, "blind": None}


def test_the_step_stitches_what_each_robot_saved(tmp_path: Path) -> None:
    save_poses(save(tmp_path / "rover", shots(TRUE)), steps(3))
    logged: list[str] = []
    reports = stitch_run(step_context(tmp_path, robots=ROBOTS, log=logged.append))
    assert list(reports) == ["rover"]
    assert logged == ["rover: 3 of 3 frames stitched into panorama.png"]
    assert json.loads((tmp_path / "rover" / "panorama.json").read_text()) == reports["rover"]
    assert load(tmp_path / "rover" / "panorama.png").shape[1] == reports["rover"]["width"]


def test_frames_that_nobody_keeps_are_checked_and_not_stitched(tmp_path: Path) -> None:
    folder = save(tmp_path / "rover", shots(TRUE))
    save_poses(folder, steps(3))
    context = step_context(tmp_path, robots=ROBOTS, keeps_files=False)
    assert [frame["file"] for frame in stitch_run(context)["rover"]["frames"]] == [f"frame.{n}.png" for n in range(3)]
    assert not (folder / "panorama.png").exists()
    with pytest.raises(ScenarioError, match=r"rover: the frames are about \d+ degrees apart"):
        stitch_run(context, field_of_view_deg=30, step_deg=45)
    (folder / "frame.1.png").write_bytes(b"")
    with pytest.raises(ScenarioError, match=r"frame\.1\.png.*cannot be read as a picture"):
        stitch_run(context)


def test_the_step_fails_with_the_names_of_frames_that_it_left_out_and_keeps_the_rest(tmp_path: Path) -> None:
    frames = shots(TRUE)
    frames[2] = np.zeros_like(frames[2])
    save_poses(save(tmp_path / "rover", frames), steps(3))
    with pytest.raises(ScenarioError, match=r"rover: frame\.2\.png is blank"):
        stitch_run(step_context(tmp_path, robots=ROBOTS))
    assert (tmp_path / "rover" / "panorama.png").is_file()


def test_the_step_fails_without_frames(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no robot has saved pictures"):
        stitch_run(step_context(tmp_path, robots=ROBOTS))
    with pytest.raises(ScenarioError, match="keeps no files"):
        stitch_run(step_context())
    assert stitch_run(step_context(tmp_path, robots=ROBOTS, is_cancelled=True)) == {}
