"""The poses and problems that a tracker finds in pictures that OpenCV draws."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors.plugin import FloorMarker, NotReadyError
from plugins.tracker.detector import Found
from plugins.tracker.feeds import PictureFeed
from plugins.tracker.lens import Lens
from plugins.tracker.settings import MarkerGroup
from plugins.tracker.tracker import Tracker
from tests.unit.plugins.tracker.pictures import DISTORTION, FLOOR, MATRIX, SIZE, Mark, View, cover, draw
from tests.unit.plugins.tracker.rig import kinds_of

ROBOTS = (Mark(1, -0.6, 0.4, 0.3, 30), Mark(2, 0.5, -0.2, 0.3, -100), Mark(3, 0.1, 0.7, 0.3, 170))
LENS = Lens(SIZE, (MATRIX[0, 0], MATRIX[1, 1]), (MATRIX[0, 2], MATRIX[1, 2]), tuple(DISTORTION))


class Pictures(PictureFeed):
    """Pictures that a test shows, each a thirtieth of a second after the last one."""

    def __init__(self) -> None:
        self.stamp_s = 0.0
        self.image: NDArray[np.uint8] | None = None
        self.noted: list[tuple[str, float]] = []

    def show(self, image: NDArray[np.uint8] | None, after_s: float = 1 / 30) -> None:
        self.image = image
        self.stamp_s += after_s

    def newest(self) -> tuple[NDArray[np.uint8], float]:
        if self.image is None:
            raise NotReadyError("the cable is out")
        return self.image, self.stamp_s

    def note(self, found: Found, stamp_s: float) -> None:
        self.noted.append((json.dumps(found.to_json()), stamp_s))


class Rig:
    """A tracker with one or several cameras in front of drawn pictures."""

    def __init__(self, cameras: int = 1, **changes: Any) -> None:
        groups = changes.get("groups") or [MarkerGroup(ids=(1, 2, 3), size_m=0.14, height_m=0.3)]
        floor = [FloorMarker(id=one.number, x_m=one.x_m, y_m=one.y_m, size_m=one.size_m) for one in FLOOR]
        self.tracker = Tracker("cameras-1", changes.get("family", "4x4_50"), groups, changes.get("floor", floor))
        self.feeds = [Pictures() for _ in range(cameras)]
        for number, feed in enumerate(self.feeds):
            self.tracker.add_camera(f"camera-{number}", LENS, feed)

    def show(self, image: NDArray[np.uint8], after_s: float = 1 / 30) -> dict[int, NDArray[np.float64]]:
        """Show a picture to all cameras, and return the poses by marker."""
        for feed in self.feeds:
            feed.show(image, after_s)
        return self.poses()

    def poses(self) -> dict[int, NDArray[np.float64]]:
        return {fix.marker: fix.pose for fix in self.tracker.fixes().fixes}


def assert_poses(poses: dict[int, NDArray[np.float64]], marks: Sequence[Mark], limit_m: float = 0.001) -> None:
    assert sorted(poses) == sorted(mark.number for mark in marks)
    for mark in marks:
        x_m, y_m, yaw_rad = poses[mark.number]
        assert math.hypot(x_m - mark.x_m, y_m - mark.y_m) < limit_m, mark
        assert abs(math.remainder(math.degrees(yaw_rad) - mark.yaw_deg, 360)) < 0.4, mark


@pytest.mark.parametrize(
    ("family", "dictionary"), [("4x4_50", cv2.aruco.DICT_4X4_50), ("36h11", cv2.aruco.DICT_APRILTAG_36h11)]
)
def test_it_finds_robots_that_drive_in_whole_pictures_and_around_predictions(family: str, dictionary: int) -> None:
    rig = Rig(family=family)
    for number in range(5):
        marks = [
            Mark(one.number, one.x_m + 0.01 * number, one.y_m, one.z_m, one.yaw_deg + 3 * number) for one in ROBOTS
        ]
        assert_poses(rig.show(draw((*FLOOR, *marks), dictionary=dictionary, seed=number)), marks)
    assert rig.tracker.cameras["camera-0"].whole_searches == 1
    assert kinds_of(rig.tracker) == {}


def test_it_finds_its_own_pose_by_the_floor() -> None:
    rig = Rig()
    rig.show(draw((*FLOOR, *ROBOTS), View(0.1, -0.05, 2.5, 7.0)))
    mounting = rig.tracker.cameras["camera-0"].mounting
    assert mounting is not None
    assert np.allclose(mounting.centre_m, (0.1, -0.05, 2.5), atol=0.01)
    assert mounting.error_px < 0.2


def test_a_hidden_marker_gets_no_fix_and_is_found_again() -> None:
    rig = Rig()
    whole = draw((*FLOOR, *ROBOTS))
    rig.show(whole)
    for _ in range(18):
        poses = rig.show(cover(whole, ROBOTS[1]))
    assert_poses(poses, (ROBOTS[0], ROBOTS[2]))
    assert kinds_of(rig.tracker) == {"not_seen": [2]}
    for _ in range(10):  # the next search of a whole picture
        poses = rig.show(whole)
    assert_poses(poses, ROBOTS)
    assert kinds_of(rig.tracker) == {}


def test_a_marker_that_is_there_twice_gets_no_fix() -> None:
    rig = Rig()
    poses = rig.show(draw((*FLOOR, *ROBOTS, Mark(2, -0.8, -0.3, 0.3))))
    assert_poses(poses, (ROBOTS[0], ROBOTS[2]))
    for _ in range(12):
        rig.show(draw((*FLOOR, *ROBOTS, Mark(2, -0.8, -0.3, 0.3))))
    assert sorted(kinds_of(rig.tracker)) == ["seen_twice"]
    for _ in range(12):
        poses = rig.show(draw((*FLOOR, *ROBOTS)))
    assert_poses(poses, ROBOTS)
    assert kinds_of(rig.tracker) == {}


def test_an_unknown_marker_is_reported() -> None:
    rig = Rig()
    for _ in range(12):
        poses = rig.show(draw((*FLOOR, *ROBOTS, Mark(17, -0.8, -0.3, 0.1))))
    assert_poses(poses, ROBOTS)
    assert kinds_of(rig.tracker) == {"unknown_marker": [17]}


def test_a_mirrored_marker_is_reported_and_gets_no_fix() -> None:
    rig = Rig()
    poses = rig.show(draw((*FLOOR, *ROBOTS[:2], Mark(3, 0.1, 0.7, 0.3, 170, is_mirrored=True))))
    assert_poses(poses, ROBOTS[:2])
    assert kinds_of(rig.tracker) == {"mirrored": [3]}


@pytest.mark.parametrize(
    ("wrong", "word"),
    [(Mark(3, 0.1, 0.7, 0.3, 20, size_m=0.1), "size"), (Mark(3, 0.1, 0.6, 0.3, 20, tilt_deg=40), "level")],
)
def test_a_marker_of_another_size_or_tilt_gets_no_fix(wrong: Mark, word: str) -> None:
    rig = Rig()
    poses = rig.show(draw((*FLOOR, *ROBOTS[:2], wrong)))
    assert_poses(poses, ROBOTS[:2])
    (problem,) = rig.tracker.problems
    assert (problem.kind, problem.marker) == ("misfit", 3)
    assert word in problem.text


def test_a_moved_floor_marker_is_left_out_and_reported() -> None:
    rig = Rig()
    moved = Mark(42, FLOOR[2].x_m - 0.15, FLOOR[2].y_m, size_m=0.2)
    poses = rig.show(draw((*FLOOR[:2], moved, FLOOR[3], *ROBOTS)))
    assert_poses(poses, ROBOTS, 0.003)
    assert kinds_of(rig.tracker) == {"floor_marker_moved": [42]}


def test_a_moved_camera_finds_its_new_pose() -> None:
    rig = Rig()
    rig.show(draw((*FLOOR, *ROBOTS)))
    kicked = draw((*FLOOR, *ROBOTS), View(0.06, 0.02, 2.58, 6.0))
    seen = set()
    for _ in range(12):
        rig.show(kicked)
        seen |= set(kinds_of(rig.tracker))
    assert "camera_moved" in seen
    assert_poses(rig.poses(), ROBOTS)


def test_without_floor_markers_it_is_not_ready_and_says_why() -> None:
    rig = Rig()
    with pytest.raises(NotReadyError, match="too few floor markers are in view: 2 of 40, 41, 42, 43 are needed"):
        rig.show(draw((FLOOR[0], *ROBOTS)))
    with pytest.raises(NotReadyError, match=r"no floor markers are given: list them as `floor`"):
        Rig(floor=[]).show(draw(ROBOTS))


def test_pictures_of_another_size_are_refused() -> None:
    rig = Rig()
    with pytest.raises(NotReadyError, match="pictures of 480 x 360 px do not fit the lens, calibrated at 960 x 720 px"):
        rig.show(np.asarray(cv2.resize(draw((*FLOOR, *ROBOTS)), (480, 360)), np.uint8))


def test_a_print_beside_the_axis_gives_the_pose_of_the_robot() -> None:
    group = MarkerGroup(ids=(1,), size_m=0.14, height_m=0.3, ahead_m=0.1, left_m=-0.05, yaw_deg=90)
    rig = Rig(groups=[group])
    yaw = math.radians(20)
    x_m = 0.2 + 0.1 * math.cos(yaw) + 0.05 * math.sin(yaw)
    y_m = 0.1 + 0.1 * math.sin(yaw) - 0.05 * math.cos(yaw)
    poses = rig.show(draw((*FLOOR, Mark(1, x_m, y_m, 0.3, 110))))
    assert_poses(poses, [Mark(1, 0.2, 0.1, 0.3, 20)])


def test_two_cameras_that_overlap_give_one_fix() -> None:
    rig = Rig(cameras=2)
    views = View(-0.3, 0.0), View(0.3, 0.05, 2.7, 3.0)
    for feed, view in zip(rig.feeds, views, strict=True):
        feed.show(draw((*FLOOR, *ROBOTS), view))
    fixes = rig.tracker.fixes().fixes
    assert_poses({fix.marker: fix.pose for fix in fixes}, ROBOTS)
    assert [fix.cameras for fix in fixes] == [("camera-0", "camera-1")] * 3
    alone = Rig()
    alone.show(draw((*FLOOR, *ROBOTS), views[0]))
    for both, one in zip(fixes, alone.tracker.fixes().fixes, strict=True):
        assert (np.diag(both.covariance) < np.diag(one.covariance)).all()


def test_cameras_that_disagree_give_no_fix_and_say_so() -> None:
    rig = Rig(cameras=2)
    apart = [Mark(one.number, one.x_m + 0.05, one.y_m, one.z_m, one.yaw_deg) for one in ROBOTS[:1]]
    rig.feeds[0].show(draw((*FLOOR, *ROBOTS)))
    rig.feeds[1].show(draw((*FLOOR, *apart, *ROBOTS[1:])))
    assert_poses(rig.poses(), ROBOTS[1:])
    assert kinds_of(rig.tracker) == {"cameras_disagree": [1]}


def test_a_lost_camera_leaves_the_other_one() -> None:
    rig = Rig(cameras=2)
    rig.show(draw((*FLOOR, *ROBOTS)))
    rig.feeds[0].show(None)
    rig.feeds[1].show(draw((*FLOOR, *ROBOTS), seed=2))
    assert [fix.cameras for fix in rig.tracker.fixes().fixes] == [("camera-1",)] * 3
    assert kinds_of(rig.tracker) == {"camera_not_ready": [None]}
    rig.feeds[1].show(None)
    with pytest.raises(NotReadyError, match="the cable is out"):
        rig.tracker.fixes()


def test_cameras_that_expose_at_different_times_agree_on_a_robot_that_drives() -> None:
    rig = Rig(cameras=2)
    rig.feeds[1].stamp_s = 0.016

    def at(stamp_s: float) -> NDArray[np.uint8]:
        return draw((*FLOOR, Mark(1, -0.5 + 0.4 * stamp_s, 0.2, 0.3, 30)), seed=round(stamp_s * 1000))

    for _ in range(4):
        for feed in rig.feeds:
            feed.show(at(feed.stamp_s + 1 / 30))
        found = rig.tracker.fixes()
    assert_poses({1: found.fixes[0].pose}, [Mark(1, -0.5 + 0.4 * found.stamp_s, 0.2, 0.3, 30)])
    assert "cameras_disagree" not in kinds_of(rig.tracker)


class Repeated(PictureFeed):
    """Findings in pictures, without the pictures."""

    def __init__(self, noted: Sequence[tuple[str, float]]) -> None:
        self.noted = list(noted)

    def known(self) -> tuple[Found, float]:
        text, stamp_s = self.noted.pop(0)
        return Found.from_json(json.loads(text)), stamp_s

    def newest(self) -> tuple[NDArray[np.uint8], float]:
        raise AssertionError("no picture is drawn again")


def test_what_was_noted_gives_the_same_fixes_to_the_bit_without_pictures() -> None:
    """Whole pictures, windows of pictures, and the mirrored markers."""
    first, again = Rig(), Rig()
    fixes = []
    for step in range(12):
        robots = [Mark(one.number, one.x_m + 0.004 * step, one.y_m, one.z_m, one.yaw_deg) for one in ROBOTS]
        fixes.append(first.show(draw((*robots, *FLOOR))))
    noted = first.feeds[0].noted
    assert {json.loads(text)["is_whole"] for text, _ in noted} == {True, False}
    again.tracker.add_camera("camera-0", LENS, Repeated(noted))
    for before in fixes:
        after = again.poses()
        assert before.keys() == after.keys() == {1, 2, 3}
        assert all((before[number] == after[number]).all() for number in before)
