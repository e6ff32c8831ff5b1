"""Drawing in a real Chromium: names, layers of the map, texts that change often, and a hundred robots."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard import Dashboard
from tests.benchmarks.dashboard import ROBOTS, drive, fleet_file
from tests.operate.dashboard.pages import connected, go
from tests.operate.dashboard.rig import counting_fleet, open_dashboard
from tests.plugin_files import write_plugin

OpenPage = Callable[..., AbstractContextManager[Page]]

COUNT_SHEETS = """() => import("/static/map_sheet.js").then(({ Sheet }) => {
    const show = Sheet.prototype.show;
    window.sheets = new Map();
    Sheet.prototype.show = function (context, width, height, key, draw) {
        const counts = window.sheets.get(this) ?? { shown: 0, drawn: 0 };
        window.sheets.set(this, counts);
        counts.shown += 1;
        show.call(this, context, width, height, key, (sheet) => { counts.drawn += 1; draw(sheet); });
    };
})"""
"""JavaScript: count how often each layer is shown, and how often it is drawn for that."""
NAMES_AT_ONE_PLACE = """() => import("/static/map_names.js").then(({ drawNames }) => {
    const written = [];
    const context = new Proxy({}, {
        get: (_, method) => (text, _x, y) => {
            if (method === "fillText") written.push([text, y < 100 ? "above" : "below"]);
            return { width: 40 };
        },
        set: () => true,
    });
    const pose = { at: [0, 0, 0] };
    const frame = { scale: 50, width: 200, toScreen: () => [100, 100] };
    drawNames(context, frame, { one: pose, two: pose, three: pose });
    return written;
})"""
ROWS_OF_A_RUN = """() => import("/static/timeline.js").then(({ Timeline }) => {
    const timeline = new Timeline();
    const rows = () => timeline.rows().map((robot) => robot ?? "together");
    const record = { robot: null, step: "steps[0]", label: "formation", start_s: 1, end_s: 2, outcome: "done" };
    timeline.add({ event: "run_started", time_s: 0, robots: ["one"], started_s: 0, scenario: "s" });
    const before = rows();
    timeline.add({ event: "step_started", time_s: 1, robot: null, step: "steps[0]", label: "formation" });
    const during = rows();
    timeline.add({ event: "step_ended", time_s: 2, record });
    return [before, during, rows()];
})"""
CALL_OFTEN = """() => import("/static/dom.js").then(async ({ throttled }) => {
    let calls = 0;
    const call = throttled(() => { calls += 1; }, 100);
    for (let time = 0; time < 50; time += 1) call();
    const atOnce = calls;
    await new Promise((resolve) => setTimeout(resolve, 400));
    return [atOnce, calls];
})"""

EYES = """\
import numpy as np

from eal_actors.plugin import DataType, EALPlugin, Resource, ResourceType, ValueInfo


class Eye(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(None, None, 3))
    taken = 0

    def get_value(self):
        self.taken += 1
        return np.full((8, 8, 3), self.taken % 256, np.uint8)


Eye0, Eye1, Eye2, Eye3, Eye4, Eye5 = (type(f"Eye{number}", (Eye,), {}) for number in range(6))
"""

pytestmark = pytest.mark.timeout(180)
expect.set_options(timeout=60_000)


@pytest.mark.slow
def test_a_hundred_robots_drive_and_the_world_beneath_is_not_drawn_again(open_page: OpenPage, tmp_path: Path) -> None:
    with (
        Fleet.load(fleet_file(tmp_path)).connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link, viewport={"width": 1440, "height": 900}) as page,
    ):
        connected(page)
        expect(page.locator(".robot-list")).to_contain_text("robot100")
        page.wait_for_function("() => document.querySelector('.map canvas').ariaLabel.includes('100 robots')")
        page.evaluate(COUNT_SHEETS)
        drive(fleet)
        page.wait_for_function(
            "() => window.sheets.size === 2 && [...window.sheets.values()].every(({ shown }) => shown >= 20)"
        )
        assert page.evaluate("() => Math.min(...[...window.sheets.values()].map(({ drawn }) => drawn))") == 0
        go(page, "fleet")
        expect(page.locator("tr[data-robot]")).to_have_count(ROBOTS)
        page.get_by_label("Find robots").fill("robot42")
        expect(page.locator("tr[data-robot]")).to_have_count(1)
        page.get_by_label("Find robots").fill("")
        page.get_by_label("Select all shown robots").check()
        expect(page.locator(".selection")).to_contain_text("100 selected")


def test_names_of_robots_at_one_place_do_not_cover_each_other(open_page: OpenPage, tmp_path: Path) -> None:
    with (
        counting_fleet(tmp_path, "one", "two", "three").connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link) as page,
    ):
        connected(page)
        page.wait_for_function("() => document.querySelectorAll('[data-robot] .state.good').length === 3")
        assert page.evaluate(NAMES_AT_ONE_PLACE) == [["one", "above"], ["two", "below"]]


def test_texts_that_change_often_are_written_now_and_then(open_page: OpenPage, dashboard: Dashboard) -> None:
    with open_page(dashboard.link) as page:
        assert page.evaluate(CALL_OFTEN) == [1, 2]


def test_steps_of_all_robots_together_have_a_row_of_their_own(open_page: OpenPage, dashboard: Dashboard) -> None:
    with open_page(dashboard.link) as page:
        both = ["together", "one"]
        assert page.evaluate(ROWS_OF_A_RUN) == [["one"], both, both]


def test_the_view_of_cameras_begins_with_as_many_as_it_shows(open_page: OpenPage, tmp_path: Path) -> None:
    write_plugin(tmp_path, "eyes", EYES, *(f"Eye{number}" for number in range(6)))
    robots = "robots: {one: {plugins: {eyes: {}}}}\n"
    (tmp_path / "fleet.yaml").write_text(f"version: 1\nname: seeing\nplugin_dirs: [plugins]\n{robots}")
    with (
        Fleet.load(tmp_path / "fleet.yaml").connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link + "#/cameras") as page,
    ):
        expect(page.locator("[data-frames]")).to_have_count(4)
        expect(page.locator("main input[type=checkbox]:disabled")).to_have_count(2)
        page.locator("main input[type=checkbox]:checked").first.uncheck()
        page.locator("main input[type=checkbox]:not(:checked)").last.check()
        expect(page.locator("[data-camera='one/Eye5'][data-frames]")).to_be_visible()


def test_every_view_has_an_icon_of_its_own(open_page: OpenPage, dashboard: Dashboard) -> None:
    with open_page(dashboard.link) as page:
        connected(page)
        icons = page.locator("#nav svg path").evaluate_all("paths => paths.map((path) => path.getAttribute('d'))")
        assert len(icons) == len(set(icons)) == page.locator("#nav a").count()
