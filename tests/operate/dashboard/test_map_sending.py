"""Robots sent from the map: planned paths, places, drawn zones and errors, also in a real Chromium."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page as BrowserPage
from playwright.sync_api import expect

from eal_actors.device.data import EALData
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from tests.operate.dashboard.rig import open_dashboard, page_of

WORLD = """\
version: 1
name: hall
size_m: [6, 4]
obstacles: [{kind: wall, start_m: [0, -2], end_m: [0, 0.6]}]
places: {dock: {x_m: 2.0, y_m: -1.0}}
"""
FLEET = """\
version: 1
name: sent
seed: 4
clock: {rate: 4}  # the faster, the sooner a busy machine makes a robot seem blocked
world: hall.yaml
robots:
  rover: {plugins: {sim: {model: roomba, start: {x_m: -2, y_m: -1, yaw_deg: 0}}}}
  other: {plugins: {sample: {}}}
"""

INKED = """(points) => points.filter(([x, y]) => {
    const canvas = document.querySelector(".map canvas");
    const scale = Math.min(canvas.clientWidth / 6, canvas.clientHeight / 4) * 0.94;
    const ratio = canvas.width / canvas.clientWidth;
    const at = [canvas.clientWidth / 2 + x * scale, canvas.clientHeight / 2 - y * scale];
    const [left, top] = at.map((part) => Math.round(part * ratio) - 1);
    const colours = canvas.getContext("2d").getImageData(left, top, 3, 3).data;
    return [...Array(9).keys()].some((pixel) => {
        const parts = colours.slice(4 * pixel, 4 * pixel + 3);
        return Math.max(...parts) - Math.min(...parts) > 50;
    });
}).length"""
"""JavaScript: how many points of the world, in m, are on something that is not grey, such as an outline."""

pytestmark = pytest.mark.timeout(180)
expect.set_options(timeout=60_000)


@pytest.fixture
def sent(tmp_path: Path) -> Iterator[Fleet]:
    (tmp_path / "hall.yaml").write_text(WORLD)
    (tmp_path / "fleet.yaml").write_text(FLEET)
    with Fleet.load(tmp_path / "fleet.yaml").connect() as fleet:
        yield fleet


def distance_to(fleet: Fleet, x_m: float, y_m: float) -> float:
    true_x_m, true_y_m, _ = fleet["rover"]["TruePose"].get_value().get().value
    return math.dist((true_x_m, true_y_m), (x_m, y_m))


def length_of(path: list[list[float]]) -> float:
    return sum(math.dist(one, other) for one, other in pairwise(path))


def test_a_robot_goes_round_the_wall_and_every_page_sees_its_path(sent: Fleet) -> None:
    with open_dashboard(sent) as dashboard, page_of(dashboard) as page, page_of(dashboard) as watcher:
        watcher.hear_until(lambda: watcher.robots.get("rover", {}).get("can_go") is True)
        assert watcher.robots["other"]["can_go"] is False
        answer = page.ask(do="send", robot="rover", x_m=2.0, y_m=-1.0)
        assert answer == {"id": 1, "ok": True}
        assert distance_to(sent, 2.0, -1.0) < 0.3  # by its odometry
        watcher.hear_until(lambda: watcher.robots["rover"]["spread_m2"] is not None)
        watcher.hear_until(lambda: len(watcher.paths) > 1)
        path, end = watcher.paths
    assert end is None
    assert length_of(path) > 2 * math.hypot(2, 1.6)


def test_impossible_goals_are_answered(sent: Fleet) -> None:
    with open_dashboard(sent) as dashboard, page_of(dashboard) as page:
        assert "is outside the map" in page.ask(do="send", robot="rover", x_m=9.0, y_m=0.0)["error"]
        assert "is inside an obstacle; the nearest free" in page.ask(do="send", robot="rover", x_m=0, y_m=-1)["error"]
        zone = [[-0.5, 0.4], [0.5, 0.4], [0.5, 2], [-0.5, 2]]
        cut_off = page.ask(do="send", robot="rover", x_m=2, y_m=-1, keep_out=[zone])
        assert (cut_off["code"], cut_off["ok"]) == ("no_path", False)
        assert "unknown robot 'nobody'" in page.ask(do="send", robot="nobody", x_m=0, y_m=0)["error"]
        assert "unknown resource 'Pose'" in page.ask(do="send", robot="other", x_m=0, y_m=0)["error"]
        page.say(do="send", id=9, robot="rover", x_m=0, y_m=0, keep_out=[[[0, 0]]])
        assert page.hear_the_end() == 1008  # no page sends that
    assert distance_to(sent, -2, -1) < 0.01


def test_a_click_sends_the_robot_and_a_drawn_zone_is_avoided(
    open_page: Callable[..., AbstractContextManager[BrowserPage]], sent: Fleet
) -> None:
    with (
        open_dashboard(sent) as dashboard,
        open_page(dashboard.link + "#/map") as page,
        page_of(
            dashboard, dashboard.link.partition("#token=")[2].partition("#")[0] or None, ping_interval=None
        ) as watcher,
    ):
        page.set_viewport_size({"width": 1200, "height": 900})
        page.get_by_label("Send", exact=True).select_option("rover")
        canvas = page.locator(".map canvas")

        def click(x_m: float, y_m: float) -> None:
            box = canvas.bounding_box()
            assert box is not None
            scale = min(box["width"] / 6, box["height"] / 4) * 0.94
            position = {"x": box["width"] / 2 + x_m * scale, "y": box["height"] / 2 - y_m * scale}
            canvas.click(position=position)  # type: ignore[arg-type]

        click(-2.0, 1.0)
        expect(page.locator("#send-status")).to_contain_text("rover is at (-2.0")
        watcher.hear_until(lambda: len(watcher.paths) == 2)
        watcher.paths.clear()
        x_m, y_m, yaw_rad = sent["rover"]["TruePose"].get_value().get().value
        sent["rover"].pose.set(x_m, y_m, math.degrees(yaw_rad)).get()
        sent["rover"]["Base"].set_config("max_uncertainty_m", 1.0).get()  # its odometry alone becomes too uncertain
        assert distance_to(sent, -2, 1) < 0.2
        page.get_by_role("button", name="Draw a keep-out zone").click()
        for corner in ((-1.6, 0.7), (-0.8, 0.7), (-0.8, 1.9), (-1.6, 1.9)):
            click(*corner)
        expect(page.locator("#send-status")).to_contain_text("4 so far")
        page.get_by_role("button", name="Close the zone").click()
        click(2.03, -0.98)
        expect(page.locator("#send-status")).to_contain_text("rover goes to dock")
        watcher.hear_until(lambda: len(watcher.paths) > 0)
        (path, *_) = watcher.paths
        assert all(not (-1.6 <= x <= -0.8 and 0.7 <= y <= 1.9) for x, y in path)
        assert min(y for x, y in path if x < -0.4) < 0.7
        expect(page.locator("#send-status")).to_contain_text("rover is at dock.")
        assert distance_to(sent, 2, -1) < 0.4
        page.get_by_role("button", name="Clear zones").click()
        expect(page.get_by_role("button", name="Clear zones")).to_be_hidden()


def lose(fleet: Fleet, covariance: np.ndarray) -> None:
    """Carry the rover to the middle of the west room; it begins again from fixes there, with their covariance."""
    pose = [-1.6, 0.2, 0.0]
    rover = fleet["rover"]
    rover["TruePose"].set_value(pose).get()
    for _ in range(200):  # on a busy machine a fix comes too late now and then
        estimate = rover["Pose"].send_req("estimate").get()
        if math.dist(estimate.value[:2], pose[:2]) < 0.1:
            return
        fix = EALData.of([*pose, *covariance.ravel()], frame_id="map", stamp_s=estimate.stamp_s)
        rover["Pose"].send_cmd("fix", fix).get()
        fleet.clock.sleep(0.1)
    raise AssertionError("the rover did not begin again from the fixes")


def test_the_ellipse_of_a_robot_has_the_size_and_the_direction_of_its_uncertainty(
    open_page: Callable[..., AbstractContextManager[BrowserPage]], sent: Fleet
) -> None:
    turn = np.array([[math.cos(0.5), -math.sin(0.5)], [math.sin(0.5), math.cos(0.5)]])
    covariance = np.diag([1e-4] * 3)
    covariance[:2, :2] = turn @ np.diag([0.08**2, 0.045**2]) @ turn.T
    lose(sent, covariance)
    numbers = np.array(sent["rover"]["Pose"].send_req("estimate").get().value)
    spread = numbers[3:].reshape(3, 3)[:2, :2]
    variances, axes = np.linalg.eigh(spread)
    assert math.sqrt(variances[1] / variances[0]) > 1.5, "an ellipse, no circle"
    angles = np.linspace(0, math.tau, 24, endpoint=False)
    rim = numbers[:2] + (axes @ (np.sqrt(5.991 * variances)[:, None] * [np.cos(angles), np.sin(angles)])).T
    with open_dashboard(sent) as dashboard, open_page(dashboard.link + "#/map") as page:
        page.set_viewport_size({"width": 1200, "height": 900})
        for share, least, most in ((1.0, 22, 24), (0.9, 0, 2), (1.1, 0, 2)):
            points = (numbers[:2] + share * (rim - numbers[:2])).tolist()
            page.wait_for_function(f"(points) => ({INKED})(points) >= {least}", arg=points, timeout=60_000)
            assert page.evaluate(INKED, points) <= most, share


def test_a_watcher_is_offered_no_robot(
    open_page: Callable[..., AbstractContextManager[BrowserPage]], sent: Fleet
) -> None:
    with open_dashboard(sent, "secret") as dashboard, open_page(dashboard.url + "#/map") as page:
        expect(page.get_by_label("Send", exact=True)).to_contain_text("no robot can go")
        expect(page.locator("#connection")).to_contain_text("connected")


def test_the_floor_from_above_lies_beneath_the_map(
    open_page: Callable[..., AbstractContextManager[BrowserPage]],
) -> None:
    config = replace(EALConfigManager.load(bundled_path("fleets/arena.yaml")).fleet, rate=1)
    with Fleet(config) as arena, open_dashboard(arena) as dashboard, open_page(dashboard.link + "#/map") as page:
        page.set_viewport_size({"width": 1200, "height": 900})
        canvas = page.locator(".map canvas")

        def brightness(x_m: float, y_m: float) -> float:
            colour = canvas.evaluate(
                """(canvas, [x, y]) => {
                    const scale = Math.min(canvas.clientWidth / 4.4, canvas.clientHeight / 3.4) * 0.94;
                    const ratio = canvas.width / canvas.clientWidth;
                    const at = [canvas.clientWidth / 2 + x * scale, canvas.clientHeight / 2 - y * scale];
                    return [...canvas.getContext("2d").getImageData(at[0] * ratio, at[1] * ratio, 1, 1).data];
                }""",
                [x_m, y_m],
            )
            return float(sum(colour[:3]) / 3)

        expect(canvas).to_have_attribute("data-floors", re.compile("[1-9]"))
        for marker in arena.config.world.markers.floor:  # type: ignore[union-attr]
            edge_m = marker.size_m / 2
            assert brightness(marker.x_m + edge_m - 0.015, marker.y_m + 0.02) < 120, "its black edge"
            assert brightness(marker.x_m + edge_m + 0.015, marker.y_m + 0.02) > 150, "its white border"
        page.get_by_role("button", name="Picture").click()
        assert brightness(1.85 + 0.085, 1.42) > 150, "the plain floor"
