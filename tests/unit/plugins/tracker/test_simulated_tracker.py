"""The tracker on the pixels of a simulated camera, judged against the true poses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from eal_actors.plugin import EALData, FleetServices, PluginContext, PluginError
from plugins.sim.camera.looking_down import OverheadLens
from plugins.sim.overhead import marker_height_m
from plugins.sim.plugin import open_camera
from plugins.tracker import plugin as tracker_plugin
from plugins.tracker.floor import FloorPicture
from plugins.tracker.lens import Lens
from plugins.tracker.locating import square_corners
from tests.manual_clock import ManualClock
from tests.unit.plugins.tracker.rig import CEILING, STEP_S, Arena, groups, lens_of, make_of, world_model

SMALL = {**CEILING, "width": 640, "height": 480}


def small_arena(count: int = 3, **changes: Any) -> Arena:
    """Return an arena whose camera has few pixels and whose markers are large, because pictures cost time."""
    model = world_model({"ceiling": SMALL}, size_m=(4.2, 3.4))
    markers = model.markers.model_copy(update={"size_m": 0.2})
    return Arena(count, model=model.model_copy(update={"markers": markers}), markers=groups(count, 0.2), **changes)


@pytest.fixture(scope="module")
def arena() -> Arena:
    return small_arena()


def test_driving_robots_are_where_the_tracker_says(arena: Arena) -> None:
    arena.drive()
    errors, surprises = [], []
    for _ in range(24):
        fixes = arena.step()
        away = arena.errors(fixes)
        errors.append(away)
        surprises += [one @ np.linalg.solve(fix.covariance, one) for one, fix in zip(away, fixes.fixes, strict=True)]
    found = np.concatenate(errors)
    assert len(found) == 24 * 3
    assert np.percentile(np.hypot(found[:, 0], found[:, 1]), 95) < 0.005
    assert np.degrees(np.percentile(np.abs(found[:, 2]), 95)) < 1
    assert np.mean(surprises) < 6, "the covariance must not promise more than is true: 3 is right"
    assert arena.kinds() == {}


def test_a_fix_has_the_time_of_the_exposure_and_a_repeated_call_the_same_picture(arena: Arena) -> None:
    fixes = arena.step()
    assert fixes.stamp_s == pytest.approx(arena.clock.now(), abs=arena.world.tick_s)
    assert fixes.rows().shape == (3, 13)
    assert np.array_equal(arena.tracker.fixes().rows(), fixes.rows())


def test_markers_are_drawn_where_opencv_projects_them(arena: Arena) -> None:
    arena.step(STEP_S)
    camera = arena.tracker.cameras["ceiling"]
    lens = OverheadLens(arena.model.cameras["ceiling"])
    marker_by_id = {marker.id: marker for marker in arena.model.markers.floor}
    arena.clock.advance(1.0)  # so that the whole picture is searched
    arena.tracker.fixes()
    seen = [one for one in camera.detections if one.number in marker_by_id]
    assert len(seen) >= 4
    for one in seen:
        marker = marker_by_id[one.number]
        corners = square_corners(marker.size_m) + np.array([marker.x_m, marker.y_m])
        places = lens.project(np.column_stack([corners, np.zeros(4)]))
        assert np.abs(one.corners - places).max() < 0.3


def _blurred(exposure_s: float) -> Arena:
    """Return an arena in which the robots drive at 0.4 m/s, to the right."""
    camera = {
        **SMALL,
        "exposure_s": exposure_s,
        "noise": 0.0,
        "blur_px": 0.0,
        "distortion": (0.0,) * 5,
        "tilt_deg": 0.0,
    }
    model = world_model({"ceiling": camera}, size_m=(4.2, 3.4))
    markers = model.markers.model_copy(update={"size_m": 0.2})
    arena = Arena(3, model=model.model_copy(update={"markers": markers}), markers=groups(3, 0.2))
    with arena.world.lock:
        arena.world.catch_up()
        for robot in arena.robots:
            arena.world.carry(robot, (robot.pose[0] - 0.3, robot.pose[1], 0.0))
            arena.world.drive(robot, 0.4, 0.4)
    arena.clock.advance(0.5)
    return arena


def test_a_long_exposure_smears_what_moves_along_its_way_only() -> None:
    """Edges across the way are as wide as the way in the exposure; edges along it stay sharp."""
    widths = {}
    for exposure_s in (0.0, 0.1):
        arena = _blurred(exposure_s)
        picture, _ = arena.camera("ceiling").newest()
        lens = OverheadLens(arena.model.cameras["ceiling"])
        number, (x_m, y_m, _) = 2, arena.truth()[2]  # the Roomba, whose plate is the nearest to the floor
        height_m = marker_height_m(make_of(number))
        (column, row), (edge, _) = (
            lens.project(np.array([[x_m, y_m, height_m], [x_m + 0.1, y_m, height_m]])).round().astype(int)
        )
        reach = edge - column
        grey = picture[..., 1].astype(float)
        across = grey[row, column + reach // 2 : column + 2 * reach]
        along = grey[row - 2 * reach : row - reach // 2, column]
        widths[exposure_s] = [np.ptp(line) / np.abs(np.diff(line)).max() for line in (across, along)]
        px_per_m = reach / 0.1
    assert widths[0.1][0] > widths[0.0][0] + 0.5 * 0.4 * 0.1 * px_per_m
    assert widths[0.1][1] < widths[0.0][1] + 0.5


@pytest.mark.parametrize("exposure_s", [pytest.param(0.0, marks=pytest.mark.slow), 0.04])
def test_motion_blur_does_not_shift_the_fixes_of_driving_robots(exposure_s: float) -> None:
    """0.4 m/s for 40 ms are 16 mm: a stamp at an end of the exposure would be 8 mm off."""
    arena = _blurred(exposure_s)
    away = np.concatenate([arena.errors(arena.step()) for _ in range(6)])
    assert len(away) == 18
    assert np.hypot(away[:, 0], away[:, 1]).max() < 0.004
    assert np.degrees(np.abs(away[:, 2])).max() < 1.0


def test_the_same_seed_gives_the_same_fixes() -> None:
    rows = []
    for _ in range(2):
        arena = small_arena(2)
        arena.drive()
        rows.append(np.concatenate([arena.step().rows() for _ in range(3)]))
    assert np.array_equal(rows[0], rows[1])


def test_a_robot_without_a_marker_in_the_settings_is_reported(arena: Arena) -> None:
    lens = arena.model.cameras["ceiling"].model_dump()
    fields = {
        "cameras": {"ceiling": {"source": "sim://world/ceiling", "lens": lens_of(lens)}},
        "markers": [{"ids": [0, 30], "size_m": 0.2, "height_m": 0.26}],
    }
    settings = tracker_plugin.Settings.model_validate(fields)
    tracker = tracker_plugin.connect(PluginContext("cameras-2", "tracker", settings, arena.services)).tracker
    for _ in range(24):
        arena.clock.advance(STEP_S)
        tracker.fixes()
    assert {(one.kind, one.marker) for one in tracker.problems} == {  # no robot carries marker 30
        ("unknown_marker", 1),
        ("unknown_marker", 2),
    }


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("sim://world/wall", r"the world 'arena' has no camera 'wall'; it has: ceiling"),
        ("sim://ceiling", r"a simulated camera has the form sim://world/<camera>"),
    ],
)
def test_an_unknown_simulated_camera_is_refused(source: str, problem: str) -> None:
    services = FleetServices(ManualClock(), 1, world_model(), open_camera=open_camera)
    fields = {"cameras": {"a": {"source": source, "lens": lens_of(CEILING)}}, "markers": groups(1)}
    context = PluginContext("cameras-1", "tracker", tracker_plugin.Settings.model_validate(fields), services)
    with pytest.raises(PluginError, match=problem):
        tracker_plugin.connect(context)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"markers": [{"ids": [40], "size_m": 0.1, "height_m": 0.1}]}, "markers 40 are on robots and on the floor"),
        ({"markers": [{"ids": [50], "size_m": 0.1, "height_m": 0.1}]}, "markers 50: the family 4x4_50 ends with 49"),
    ],
)
def test_ids_that_cannot_be_are_refused(changes: dict[str, Any], problem: str) -> None:
    services = FleetServices(ManualClock(), 1, world_model(), open_camera=open_camera)
    fields = {"cameras": {"a": {"source": "sim://world/ceiling", "lens": lens_of(CEILING)}}, **changes}
    context = PluginContext("cameras-1", "tracker", tracker_plugin.Settings.model_validate(fields), services)
    with pytest.raises(PluginError, match=problem):
        tracker_plugin.connect(context)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"markers": [{"ids": [1, 1], "size_m": 0.1, "height_m": 0.1}]}, "markers 1 are listed twice"),
        ({"markers": [{"ids": [-1], "size_m": 0.1, "height_m": 0.1}]}, "an id is 0 or more, not -1"),
        ({"markers": []}, "at least 1"),
        ({"cameras": {}}, "at least 1"),
    ],
)
def test_settings_that_cannot_be_are_refused(changes: dict[str, Any], problem: str) -> None:
    fields = {"cameras": {"a": {"source": 0, "lens": lens_of(CEILING)}}, "markers": groups(1), **changes}
    with pytest.raises(ValueError, match=problem):
        tracker_plugin.Settings.model_validate(fields)


def test_rays_and_pixels_of_a_lens_are_inverse() -> None:
    lens = Lens((1280, 960), (985.0, 985.0), (639.5, 479.5), CEILING["distortion"])
    pixels = np.random.default_rng(3).uniform((0, 0), (1280, 960), (50, 2))
    points = np.column_stack([lens.rays(pixels), np.ones(50)])
    assert np.allclose(lens.pixels(points, np.zeros(3), np.zeros(3)), pixels, atol=1e-3)


FOLDING = (-0.35, 0.12, 0.0, 0.0, -0.02)
"""A distortion whose polynomial leads back into the picture from 57 degrees off the axis on."""


def test_a_lens_shows_nothing_behind_it_and_nothing_beyond_where_its_distortion_leads_back() -> None:
    lens, still = Lens((1280, 960), (640.0, 640.0), (639.5, 479.5), FOLDING), np.zeros(3)
    points = np.column_stack([np.linspace(0, 3, 61), np.zeros(61), np.ones(61)])
    count = int(lens.has_in_front(points, still, still).sum())
    columns = lens.pixels(points, still, still)[:, 0]
    assert 20 < count < 40
    assert (np.diff(columns[:count]) > 0).all()
    assert columns[count + 1] < columns[count]
    assert not lens.has_in_front(-points, still, still).any()


def test_the_floor_is_black_where_no_camera_looks_also_with_a_wide_lens() -> None:
    marks = [{"id": number, "x_m": x_m, "y_m": 0.5, "size_m": 0.2} for number, x_m in ((40, -0.7), (41, 0.7))]
    camera = {"z_m": 1.4, "fov_deg": 90.0, "distortion": FOLDING, "noise": 0.0}
    arena = Arena(1, model=world_model({"ceiling": camera}, markers={"size_m": 0.12, "floor": marks}))
    floor = FloorPicture(arena.tracker, arena.model.size_m).get_value()
    assert isinstance(floor, EALData)
    rows, columns, _ = floor.value.shape
    assert floor.value[rows // 2, columns // 2].any()
    assert not floor.value[:8, :8].any()  # 63 degrees off the axis


def test_markers_without_pictures_are_where_they_are_found_in_pictures() -> None:
    drawn, computed = small_arena(), small_arena(drawn=False)
    for arena in (drawn, computed):
        arena.drive()
    for _ in range(6):
        fixes = computed.step()
        assert len(drawn.step().fixes) == len(fixes.fixes) == 3
        assert np.abs(computed.errors(fixes)[:, :2]).max() < 0.001
        views = (
            {one.number: one.corners for one in arena.tracker.cameras["ceiling"].detections}
            for arena in (drawn, computed)
        )
        found, known = views
        assert set(found) <= set(known)
        assert max(np.abs(found[number] - known[number]).max() for number in found) < 0.5
    assert computed.kinds() == {}
    assert computed.tracker.cameras["ceiling"].picture is None  # nothing was drawn
    assert computed.tracker.look()[0].picture is not None  # until somebody looks


@pytest.mark.parametrize("drawn", [True, False])
def test_a_marker_behind_a_higher_robot_is_hidden(drawn: bool) -> None:
    low = {**SMALL, "x_m": -1.6, "z_m": 1.2, "yaw_deg": 0.0, "tilt_deg": 45.0, "fov_deg": 90.0}
    model = world_model({"ceiling": low}, size_m=(4.2, 3.4))
    markers = model.markers.model_copy(update={"size_m": 0.2})
    arena = Arena(3, model=model.model_copy(update={"markers": markers}), markers=groups(3, 0.2), drawn=drawn)
    tall, roomba = arena.robots[1:]
    for tall_at, is_seen in (((0.0, 1.2, 0.0), True), ((-0.18, -0.3, 0.0), False)):
        with arena.world.lock:
            arena.world.carry(roomba, (0.2, -0.3, 0.0))
            arena.world.carry(tall, tall_at)
        arena.clock.advance(1.0)
        arena.tracker.report(arena.clock.now())
        seen = {one.number for one in arena.tracker.cameras["ceiling"].detections}
        assert (2 in seen) is is_seen, tall_at
