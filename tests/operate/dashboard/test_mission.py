"""Mission control, the map's playback and commands to a selection, in a real Chromium."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard import Dashboard, LogTap
from tests.operate.dashboard.rig import COUNTING_PLUGIN, SIM, counting_fleet, open_dashboard, resource_of
from tests.plugin_files import write_plugin
from tests.scenario_texts import scenario_of

OpenPage = Callable[..., AbstractContextManager[Page]]

pytestmark = pytest.mark.timeout(180)
expect.set_options(timeout=20_000)

SIZES = ((1440, 900), (1024, 768), (768, 1024), (390, 844))


def test_the_front_page_shows_map_robots_cameras_and_alerts_at_four_sizes(open_page: OpenPage) -> None:
    with (
        Fleet.load(SIM).connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link) as page,
    ):
        expect(page.locator("[data-robot='roomba-1']")).to_contain_text("100 %")
        expect(page.locator("[data-camera='evbot2-1/Camera']")).to_have_attribute("data-frames", re.compile(r"\d+"))
        expect(page.locator(".no-poses")).to_be_hidden()
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            for part in ("Map", "Robots", "Cameras"):
                expect(page.get_by_role("region", name=part)).to_be_visible()
            wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
            assert wide <= 0, f"{width} px: {wide} px too wide"
        radii = page.evaluate(
            "import('/static/store.js').then(({ store }) => store.names().map((name) => store.robots[name].radius_m))"
        )
        assert all(0.1 < radius_m < 0.3 for radius_m in radii)


@pytest.mark.parametrize(("more", "state"), [("", "not ready"), (", sample: {}", "partly ready")])
def test_a_robot_whose_device_is_absent_says_why_once(
    open_page: OpenPage, tmp_path: Path, more: str, state: str
) -> None:
    file = tmp_path / "fleet.yaml"
    roomba = "roomba: {protocol: oi, port: /dev/nowhere}"
    file.write_text(f"version: 1\nrobots: {{create: {{plugins: {{{roomba}{more}}}}}}}\n")
    with (
        Fleet.load(file).connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link + "#/fleet") as page,
    ):
        row = page.locator("tr", has_text="create")
        expect(row.locator(".state")).to_have_text(re.compile(rf"{state}$"))
        expect(row.get_by_text("cannot open /dev/nowhere")).to_have_count(1)
        page.goto(dashboard.link + "#/robot/create")
        expect(page.get_by_text("cannot open /dev/nowhere")).to_have_count(1)


def test_a_robot_that_failed_is_one_alert_beside_the_line_of_the_log(open_page: OpenPage, tmp_path: Path) -> None:
    write_plugin(tmp_path, "broken", '\ndef connect(): raise RuntimeError("no arm")\n', "Arm")
    file = tmp_path / "fleet.yaml"
    file.write_text("version: 1\nplugin_dirs: [plugins]\nrobots: {one: {plugins: {broken: {}}}}\n")
    with (
        LogTap() as log,
        Fleet.load(file).connect() as fleet,
        open_dashboard(fleet, log=log) as dashboard,
        open_page(dashboard.link) as page,
    ):
        alerts = page.get_by_role("region", name="Alerts").locator("li")
        expect(alerts).to_contain_text([re.compile("one failed · none of its.*no arm"), "robot has failed"])
        expect(page.get_by_text("no arm")).to_have_count(1)
        page.keyboard.press("Escape")
        expect(page.locator("#stopped")).to_contain_text("All robots refuse to move")
        page.reload()
        expect(page.locator("#stopped")).to_contain_text("All robots refuse to move")
        expect(alerts).to_contain_text([re.compile("one failed · none of its.*no arm"), "robot has failed"])


def test_nothing_covers_the_tools_of_the_map_in_any_view(open_page: OpenPage, fleet: Fleet, tmp_path: Path) -> None:
    (tmp_path / "turn.yaml").write_text(scenario_of("send_cmd: {resource: Base, cmd: turn9}", role="all"))
    on_top = """(node) => {
        node.scrollIntoView({ block: "center" });
        const { x, y, width, height } = node.getBoundingClientRect();
        return [[0.5, 0.1], [0.5, 0.9]].every(([right, down]) =>
            node.contains(document.elementFromPoint(x + right * width, y + down * height)));
    }"""
    with open_dashboard(fleet, scenarios=tmp_path) as dashboard, open_page(dashboard.link + "#/scenario") as page:
        page.get_by_label("Scenario", exact=True).select_option("turn.yaml")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.locator("#main")).to_contain_text("Done")
        for width, height in (*SIZES, (1440, 700)):
            page.set_viewport_size({"width": width, "height": height})
            for view in ("mission", "map", "scenario"):
                page.evaluate("(view) => { location.hash = `#/${view}`; }", view)
                for name in ("Live", "Zoom in"):
                    button = page.get_by_role("button", name=name)
                    expect(button).to_be_visible()
                    assert button.evaluate(on_top), f"{name} is covered in {view} at {width} x {height}"


def test_long_names_of_robots_widen_no_view_of_a_phone(open_page: OpenPage, tmp_path: Path) -> None:
    """A page wider than the screen has a taller window too, with STOP below the edge of the screen."""
    name = "robot-" + "x" * 60
    phone = {"viewport": {"width": 360, "height": 640}, "is_mobile": True, "has_touch": True}
    with (
        counting_fleet(
            tmp_path, name, more=f"  camera-{'y' * 60}: {{plugins: {{sim: {{model: roomba}}}}}}"
        ).connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link + "#/fleet", **phone) as page,
    ):
        expect(page.locator("tr[data-robot]")).to_have_count(2)
        for view in ("mission", "fleet", "map", "cameras", "scenario", "logs", f"robot/{name}"):
            page.evaluate("(view) => { location.hash = `#/${view}`; }", view)
            expect(page.locator("nav [aria-current]")).to_have_attribute(
                "href", f"#/{view.partition('/')[0]}".replace("robot", "fleet")
            )
            assert page.evaluate("[innerWidth, innerHeight]") == [360, 640], view
            box = page.locator("#stop").bounding_box()
            assert box is not None
            assert box["y"] + box["height"] <= 640, view
            assert page.evaluate(
                """() => [...document.querySelectorAll("#main :is(select, label, .map canvas)")]
                    .every((node) => node.getBoundingClientRect().right <= innerWidth)"""
            ), view


def test_the_map_shows_the_beginning_of_each_name(open_page: OpenPage, tmp_path: Path) -> None:
    """The names of robots at the edge of the map are inside it."""
    texts = """() => {
        window.texts = {};
        const { fillText } = CanvasRenderingContext2D.prototype;
        CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
            const half = this.measureText(text).width / 2;
            window.texts[text] = [x - half, x + half, this.canvas.clientWidth];
            return fillText.call(this, text, x, y);
        };
    }"""
    file = tmp_path / "fleet.yaml"
    file.write_text(
        "version: 1\nworld: empty\nrobots:\n"
        "  a-robot-at-the-left: {plugins: {sim: {model: roomba, start: {x_m: -2.7, y_m: 0}}}}\n"
        "  a-robot-at-the-right: {plugins: {sim: {model: roomba, start: {x_m: 2.7, y_m: 0}}}}\n"
        f"  {'b' * 60}: {{plugins: {{sim: {{model: roomba, start: {{x_m: 0, y_m: 1}}}}}}}}\n"
    )
    with (
        Fleet.load(file).connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link, viewport={"width": 360, "height": 640}) as page,
    ):
        page.evaluate(texts)
        page.evaluate("location.hash = '#/map'")
        page.wait_for_function("() => Object.keys(window.texts).length >= 3")
        spans = page.evaluate("window.texts")
        assert all(left >= 0 for left, _, _ in spans.values())
        assert all(right <= width for left, right, width in spans.values() if right - left <= width)


def test_a_page_that_is_loaded_during_a_run_offers_the_scenario_that_runs(
    open_page: OpenPage, fleet: Fleet, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.yaml").write_text(scenario_of("send_cmd: {resource: Base, cmd: turn9}", name=name))
    with open_dashboard(fleet, scenarios=tmp_path) as dashboard, open_page(dashboard.link + "#/scenario") as page:
        choice = page.get_by_label("Scenario", exact=True)
        expect(choice).to_have_value("a.yaml")
        choice.select_option("b.yaml")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.locator("#main")).to_contain_text("Done")
        page.reload()
        expect(choice).to_have_value("b.yaml")


def test_an_alert_names_the_robot_and_goes_when_it_is_over(
    open_page: OpenPage, fleet: Fleet, dashboard: Dashboard
) -> None:
    with open_page(dashboard.link) as page:
        alerts = page.get_by_role("region", name="Alerts")
        expect(alerts).to_contain_text("Nothing needs attention")
        page.evaluate("location.hash = '#/robot/one'")
        page.locator("form", has=page.locator("code", has_text="fail")).get_by_role("button").click()
        page.evaluate("location.hash = '#/mission'")
        expect(alerts.locator("li")).to_contain_text(["one Base fail: "])
        alerts.get_by_role("link", name="one").click()
        expect(page.get_by_role("heading", name="one")).to_be_visible()


def test_the_same_alert_of_many_robots_is_one(open_page: OpenPage, tmp_path: Path) -> None:
    names = [f"robot{number}" for number in range(1, 7)]
    with (
        counting_fleet(tmp_path, *names).connect() as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link + "#/fleet") as page,
    ):
        expect(page.locator("tr[data-robot]")).to_have_count(len(names))
        page.get_by_label("Select all shown robots").check()
        chosen = page.locator(".selection")
        chosen.get_by_label("Command").select_option(label="Base: fail")
        chosen.get_by_role("button", name="Send").click()
        page.evaluate("location.hash = '#/mission'")
        alerts = page.get_by_role("region", name="Alerts").locator("li")
        expect(alerts).to_contain_text([re.compile("robot1 robot2 robot3 and 3 more Base fail: .*fell off")])
        alerts.get_by_role("link", name="and 3 more").click()
        expect(page.get_by_role("heading", name="Fleet")).to_be_visible()


def test_a_map_without_poses_explains_itself(open_page: OpenPage, tmp_path: Path) -> None:
    counting_fleet(tmp_path, "one")
    write_plugin(tmp_path, "counting", COUNTING_PLUGIN, "Base")
    with (
        Fleet.load(tmp_path / "fleet.yaml").connect() as opened,
        open_dashboard(opened) as dashboard,
        open_page(dashboard.link) as page,
    ):
        expect(page.locator(".no-poses")).to_contain_text("No robot reports where it is")


def test_the_map_plays_back_the_last_minutes(open_page: OpenPage, dashboard: Dashboard) -> None:
    with open_page(dashboard.link + "#/map") as page:
        shown = "import('/static/store.js').then(({ store }) => store.poses.one?.at[0])"
        page.wait_for_function(f"() => {shown}.then((x) => x > 1)")
        slider = page.get_by_role("slider", name="Playback")
        page.wait_for_function("() => Number(document.querySelector('.playback input').min) <= -2")
        slider.evaluate("(node) => { node.value = node.min; node.dispatchEvent(new Event('input')); }")
        expect(page.locator(".map")).to_have_class("panel map past")
        expect(page.locator(".playback")).to_contain_text("s ago")
        page.get_by_role("button", name="Live").click()
        expect(page.locator(".playback")).to_contain_text("now")
        expect(page.locator(".map")).to_have_class("panel map")


def test_the_table_is_searched_sorted_and_grouped(open_page: OpenPage, dashboard: Dashboard) -> None:
    with open_page(dashboard.link + "#/fleet") as page:
        rows = page.locator("tr[data-robot]")
        expect(rows).to_have_count(2)
        page.get_by_role("button", name="Robot", exact=True).click()
        page.get_by_role("button", name="Robot", exact=True).click()
        expect(page.get_by_role("columnheader", name="Robot", exact=True)).to_have_attribute("aria-sort", "ascending")
        page.get_by_label("Find robots").fill("ready tw")
        expect(rows).to_have_count(1)
        expect(rows).to_contain_text("two")
        page.get_by_label("Find robots").fill("nothing like it")
        expect(page.locator("table")).to_contain_text("No robot matches.")
        page.get_by_label("Find robots").fill("")
        page.get_by_label("Group by").select_option("tag")
        expect(page.get_by_role("rowheader", name="no tag (2)")).to_be_visible()


def test_a_selection_outlives_a_lost_server(open_page: OpenPage, fleet: Fleet) -> None:
    with ExitStack() as stack:
        dashboard = stack.enter_context(open_dashboard(fleet))
        page = stack.enter_context(open_page(dashboard.link + "#/fleet", expects_errors=True))
        expect(page.locator("tr[data-robot]")).to_have_count(2)
        page.get_by_label("Select two").check()
        dashboard.close()
        expect(page.locator("#connection")).to_contain_text("no connection")
        stack.enter_context(open_dashboard(fleet, port=dashboard.port))
        expect(page.locator("#connection")).to_contain_text("connected")
        expect(page.locator(".selection")).to_contain_text("1 selected")
        expect(page.get_by_label("Select two")).to_be_checked()


def test_a_selection_is_commanded_together_with_a_checked_argument(
    open_page: OpenPage, fleet: Fleet, dashboard: Dashboard
) -> None:
    with open_page(dashboard.link + "#/fleet") as page:
        expect(page.locator("tr[data-robot]")).to_have_count(2)
        page.get_by_label("Select all shown robots").check()
        bar = page.locator(".selection")
        expect(bar).to_contain_text("2 selected")
        bar.get_by_label("Command").select_option(label="Base: turn<degrees>")
        field = bar.locator("input")
        field.fill("400")
        bar.get_by_role("button", name="Send").click()
        expect(bar).to_contain_text("must be a number from 0 to 360 deg")
        field.fill("30")
        bar.get_by_role("button", name="Send").click()
        expect(bar).to_contain_text("✓ turn30: 2 of 2 robots done")
        bar.get_by_label("Command").select_option(label="Base: fail")
        bar.get_by_role("button", name="Send").click()
        expect(bar).to_contain_text("✕ fail: 0 of 2 done. one: ")
        bar.get_by_label("Command").select_option(label="Base: hold")
        bar.get_by_role("button", name="Send").click()
        expect(page.locator("tr[data-robot='two']")).to_contain_text("▶ hold")
        bar.get_by_role("button", name="Halt").click()
        expect(page.locator("tr[data-robot='two']")).to_contain_text("idle")
        assert all(resource_of(fleet, name, "Base").halts for name in fleet)
        bar.get_by_role("button", name="Clear selection").click()
        expect(bar).to_be_hidden()
