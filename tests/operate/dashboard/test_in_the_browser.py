"""The page in a real Chromium, with simulated and counting fleets."""

from __future__ import annotations

import re
import shutil
import signal
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from eal_actors.facade.fleet import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.clock import wall_time
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import OperatorSection
from eal_actors.managers.keys.certificates import key_file, make_authority, make_certificate
from eal_actors.operate.dashboard import Access, Dashboard, tls_context
from eal_actors.operate.dashboard.sign_in import WRONG_TOKENS
from eal_actors.operate.dashboard.tokens import hash_token, new_token
from tests.net.links import free_port
from tests.net.rig import Rig, served
from tests.operate.dashboard.pages import VIEWS, OpenPage, connected, go, wait_until_halted
from tests.operate.dashboard.rig import ROOT, SIM, open_dashboard, resource_of
from tests.operate.dashboard.test_command import started

NOTE_PRESSES = "addEventListener('keydown', (event) => { window.pressedMs = Date.now(); }, { capture: true })"
POSES = "import('/static/store.js').then((module) => JSON.stringify(module.store.poses))"

pytestmark = pytest.mark.timeout(180)


# A scenario, from its start to the stop.


def test_the_page_starts_shows_and_stops_the_dance(open_page: OpenPage, tmp_path: Path) -> None:
    with (
        Fleet.load(SIM).connect() as fleet,
        open_dashboard(fleet, scenarios=ROOT / "scenarios", runs_dir=tmp_path / "runs") as dashboard,
        open_page(dashboard.link + "#/scenario") as page,
    ):
        connected(page)
        before = page.evaluate(POSES)
        page.get_by_label("Scenario", exact=True).first.select_option("dance.yaml")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.locator("#main")).to_contain_text("▶ Running")
        expect(page.locator(".run-map canvas")).to_be_visible()
        page.wait_for_function(f"(before) => {POSES}.then((now) => now !== before)", arg=before)
        page.evaluate(NOTE_PRESSES)
        page.keyboard.press("Escape")
        expect(page.locator("#notices")).to_contain_text("3 of 3 robots confirmed the stop")
        pressed_s = page.evaluate("window.pressedMs") / 1000
        rate = fleet.clock.of_real(1.0)
        late_s = fleet.clock.now() - (wall_time().timestamp() - pressed_s - 0.5) * rate  # half a real second after it
        for name in fleet:
            places = poses_after(fleet, name, late_s)
            assert len(places) == 1, f"{name} still moved half a second after the stop: {places}"
        expect(page.locator("#stopped")).to_contain_text("All robots refuse to move")
        expect(page.locator("#main")).to_contain_text("Aborted")
        assert all(robot.stopped_because for robot in fleet.values())


def test_a_running_command_shows_its_progress_and_controller(
    open_page: OpenPage, fleet: Fleet, dashboard: Dashboard
) -> None:
    with open_page(dashboard.link + "#/robot/one") as page, open_page(dashboard.link + "#/fleet") as other:
        far = page.locator("form", has=page.locator("code", has_text=re.compile("^far$")))
        far.get_by_role("button").click()
        expect(page.locator("main")).to_contain_text("▶ far, 25 % a quarter")
        expect(page.locator(".facts")).to_contain_text("Controlled byBase: this page")
        row = other.locator("tr[data-robot='one']")
        expect(row).to_contain_text("▶ far, 25 % a quarter")
        expect(row).to_contain_text(re.compile(r"Base: another page \(browser \d+\)"))
        fleet["one"].halt().get()
        expect(row).to_contain_text("idle")
        expect(row).to_contain_text("nobody")


def test_the_view_replays_a_run_and_links_to_its_report(open_page: OpenPage, fleet: Fleet, tmp_path: Path) -> None:
    """The report ran no scripts here. Escape stops the robots from inside the replay too."""
    scenarios = tmp_path / "scenarios"
    scenarios.mkdir()
    (scenarios / "turn.yaml").write_text(
        "version: 1\nname: turn\nroles: {all: {}}\n"
        "steps:\n  - on: all\n    do:\n      - send_cmd: {resource: Base, cmd: turn9}\n"
    )
    with (
        open_dashboard(fleet, scenarios=scenarios, runs_dir=tmp_path / "runs") as dashboard,
        open_page(dashboard.link + "#/scenario") as page,
    ):
        page.get_by_role("button", name="Start", exact=True).click()
        with page.context.expect_page() as opened:
            page.get_by_role("link", name="Report").click()
        expect(opened.value).to_have_title("turn on counted: done")
        expect(opened.value.locator("table").first).to_contain_text("two")
        replay = page.frame_locator("iframe[title='Replay of the run']")
        expect(page.locator("iframe[title='Replay of the run']")).to_be_visible()
        expect(replay.locator("#player-now")).to_contain_text("one")  # the player has run
        expect(replay.locator(".bar").first).to_have_text("turn9")
        replay.locator("#player-time").focus()
        page.keyboard.press("Escape")
        expect(page.locator("#notices")).to_contain_text("2 of 2 robots confirmed the stop")
        assert all(robot.stopped_because for robot in fleet.values())


def test_the_range_of_a_parameter_may_be_open(open_page: OpenPage, fleet: Fleet, tmp_path: Path) -> None:
    (tmp_path / "turn.yaml").write_text(
        "version: 1\nname: turn\nroles: {all: {}}\n"
        "parameters: {volts: {type: double, minimum: 0, default: 6}, laps: {type: int, maximum: 3, default: 1}}\n"
        "steps: [{log: hello}]\n"
    )
    with (
        open_dashboard(fleet, scenarios=tmp_path, runs_dir=tmp_path / "runs") as dashboard,
        open_page(dashboard.link + "#/scenario") as page,
    ):
        form = page.locator("main")
        expect(form).to_contain_text("At least 0.")
        expect(form).to_contain_text("At most 3.")
        page.get_by_label("volts").fill("-1")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(form).to_contain_text("volts must be double at least 0")


def poses_after(fleet: Fleet, robot: str, start_s: float) -> set[tuple[float, ...]]:
    """Return the different poses of a robot in the second after a time of the fleet's clock."""
    places = set()
    with fleet[robot]["TruePose"].stream(rate_hz=50) as poses:
        for pose in poses:
            assert pose.stamp_s is not None
            if pose.stamp_s >= start_s:
                places.add(tuple(pose.value))
            if pose.stamp_s > start_s + 1.0:
                break
    return places


@pytest.mark.slow
def test_a_camera_that_freezes_is_marked(open_page: OpenPage) -> None:
    with (
        Fleet.load(SIM).connect(["roomba-1"]) as fleet,
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link + "#/cameras") as page,
    ):
        tile = page.locator("[data-camera='roomba-1/Camera']")
        expect(tile).to_have_attribute("data-frames", re.compile(r"[3-9]|\d\d"))
        expect(tile).not_to_have_class(re.compile("frozen"))
        fleet["roomba-1"]["Faults"].set_config("frozen", "Camera").get()
        expect(tile).to_contain_text("✕ FROZEN: no new frame for")
        expect(tile).to_contain_text("old")
        fleet["roomba-1"]["Faults"].send_cmd("clear").get()
        expect(tile).not_to_have_class(re.compile("frozen"))
        go(page, "robot/roomba-1")
        expect(page.locator(".cockpit [data-camera='roomba-1/Camera']")).to_have_attribute(
            "data-frames", re.compile(r"[3-9]|\d\d")
        )
        check_the_values_of_a_simulated_robot(page, fleet)


def check_the_values_of_a_simulated_robot(page: Page, fleet: Fleet) -> None:
    """Check that the page of a robot shows its numbers with units, draws them, and turns off what is not there."""
    readings = page.locator(".reading")
    yaw = readings.and_(page.locator("[data-resource='TruePose']")).locator(".sample").nth(2)
    expect(yaw).to_contain_text(re.compile(r"^yaw-?\d\.\d{3} rad$"))
    expect(readings.and_(page.locator("[data-resource='Bump']"))).to_contain_text("○ false")
    expect(readings.and_(page.locator("[data-resource='Range']"))).to_contain_text(re.compile(r"\d … \d\.\d+ m$"))
    flat = yaw.locator("path").get_attribute("d")
    before = yaw.inner_text()
    page.locator("form", has=page.locator("code", has_text=re.compile("^l$"))).get_by_role("button").click()
    expect(yaw).not_to_have_text(before)
    expect(yaw.locator("svg")).to_have_attribute("data-samples", re.compile(r"[5-9]|\d\d"))
    assert yaw.locator("path").get_attribute("d") != flat
    fleet["roomba-1"]["Faults"].set_config("frozen", "Compass").get()
    expect(readings.and_(page.locator("[data-resource='Compass']"))).to_contain_text(re.compile("measured .* s ago"))


def test_an_unplugged_robot_is_shown_as_lost_and_comes_back(open_page: OpenPage, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "fleets", tmp_path / "fleets")
    file = tmp_path / "fleets/served.yaml"
    robots = {name: f'{{address: "tcp/127.0.0.1:{free_port()}"}}' for name in ("evbot2-1", "roomba-1")}
    lines = "".join(f"  {name}: {address}\n" for name, address in robots.items())
    file.write_text(f"version: 1\nname: served\ninclude: [sim.yaml]\nnetwork: {{dead_man_s: 1.0}}\nrobots:\n{lines}")
    config = EALConfigManager.load(file).fleet
    with ExitStack() as stack:
        stack.enter_context(RobotService(config, "evbot2-1"))
        plugged = stack.enter_context(ExitStack())
        plugged.enter_context(RobotService(config, "roomba-1"))
        fleet = stack.enter_context(Fleet(config).connect(list(robots)))
        dashboard = stack.enter_context(open_dashboard(fleet))
        page = stack.enter_context(open_page(dashboard.link + "#/fleet"))
        row, other = (page.locator(f"tr[data-robot='{name}']") for name in ("roomba-1", "evbot2-1"))
        expect(row).to_contain_text("ready")
        expect(row).to_contain_text(re.compile(r"\d ms"))
        plugged.close()
        expect(row).to_contain_text("lost")
        expect(other).to_contain_text("ready")
        plugged.enter_context(RobotService(config, "roomba-1"))
        expect(row).to_contain_text("ready")


# Stop.


@pytest.mark.parametrize("view", VIEWS)
def test_escape_stops_every_robot_from_every_view(
    open_page: OpenPage, fleet: Fleet, dashboard: Dashboard, view: str
) -> None:
    with open_page(dashboard.link + f"#/{view}") as page:
        connected(page)
        fields = page.locator("main input[type=text], main input[type=search]")
        if view in ("logs", "robot/one"):
            fields.first.focus()  # as if the user typed
        page.keyboard.press("Escape")
        for name in fleet:
            wait_until_halted(resource_of(fleet, name, "Base"))
        expect(page.locator("#stopped")).to_be_visible()
        assert all(robot.stopped_because for robot in fleet.values())


def test_two_browsers_see_one_fleet_and_either_may_resume(
    open_page: OpenPage, fleet: Fleet, dashboard: Dashboard
) -> None:
    with (
        open_page(dashboard.link + "#/fleet") as first,
        open_page(dashboard.link + "#/fleet", viewport={"width": 375, "height": 740}) as second,
    ):
        connected(second)
        connected(first)
        first.get_by_role("button", name="STOP").click()
        expect(second.locator("#stopped")).to_contain_text("All robots refuse to move")
        expect(second.locator("tr[data-robot='two']")).to_contain_text("stopped")
        second.get_by_role("button", name="Resume …").click()
        second.keyboard.press("Escape")  # which never resumes
        expect(second.locator("#confirm")).to_be_hidden()
        assert fleet["one"].stopped_because
        second.get_by_role("button", name="Resume …").click()
        second.locator("#stop").click()  # the question is not in its way
        expect(second.locator("#confirm")).to_be_hidden()
        second.get_by_role("button", name="Resume …").click()
        second.get_by_role("button", name="Resume", exact=True).click()
        expect(first.locator("#stopped")).to_be_hidden()
        assert fleet["one"].stopped_because is None


def test_the_banner_names_the_robots_that_have_not_confirmed_the_stop(open_page: OpenPage, tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("r1", "r2", "r3"), {"lease_s": 20.0, "dead_man_s": 20.0})
    with (
        served(rig) as (running, fleet),
        open_dashboard(fleet) as dashboard,
        open_page(dashboard.link + "#/fleet") as page,
    ):
        connected(page)
        banner, frozen = page.locator("#stopped"), page.locator("tr[data-robot='r3']")
        expect(frozen).to_contain_text("ready")
        running["r3"].freeze()
        page.keyboard.press("Escape")
        expect(banner).to_contain_text("2 of 3 stopped, r3 NOT CONFIRMED: STOP on the dashboard")
        expect(frozen).to_contain_text("stop NOT CONFIRMED")
        expect(page.locator("tr[data-robot='r1']")).to_contain_text("stopped")
        expect(page.locator("#notices")).to_contain_text("Stop not confirmed: r3")
        expect(banner).to_contain_text("2 of 3 stopped, r3 NOT CONFIRMED")  # though the request is over
        running["r3"].thaw()
        expect(banner).to_contain_text("All robots refuse to move")
        expect(banner).not_to_contain_text("NOT CONFIRMED")


def test_a_page_without_a_server_is_dimmed_and_says_when_it_was_seen(open_page: OpenPage, tmp_path: Path) -> None:
    with started(tmp_path) as (process, link), open_page(link, expects_errors=True) as page:
        connected(page)
        expect(page.locator("#outdated")).to_be_hidden()
        process.send_signal(signal.SIGSTOP)  # its connection stays open
        expect(page.locator("#outdated")).to_contain_text(re.compile(r"last seen at \d\d:\d\d:\d\d"))
        expect(page.locator("body")).to_have_class("outdated")
        expect(page.locator("#connection")).to_have_text("▲ no answer")
        page.keyboard.press("Escape")
        expect(page.locator("#notices")).to_contain_text("STOP NOT CONFIRMED: no answer yet")
        process.send_signal(signal.SIGCONT)
        expect(page.locator("#outdated")).to_be_hidden()
        expect(page.locator("#stopped")).to_contain_text("All robots refuse to move")
        expect(page.locator("#notices")).to_contain_text("confirmed the stop")
        expect(page.locator("#notices")).not_to_contain_text("NOT CONFIRMED", timeout=1000)
        process.kill()
        expect(page.locator("#outdated")).to_be_visible()
        expect(page.locator("#connection")).to_contain_text("no connection")


def test_stop_is_the_first_in_the_order_of_the_tab_key(open_page: OpenPage, dashboard: Dashboard) -> None:
    with open_page(dashboard.link + "#/fleet") as page:
        connected(page)
        page.keyboard.press("Tab")
        expect(page.locator("#stop")).to_be_focused()


# Access.


def test_a_wrong_token_may_watch_and_the_right_one_may_command(open_page: OpenPage, fleet: Fleet) -> None:
    token = new_token()
    with open_dashboard(fleet, token) as dashboard:
        with open_page(f"{dashboard.url}#token=wrong") as page:
            expect(page.locator("#permission")).to_contain_text("read only: wrong token")
            assert "token" not in page.url
            expect(page.locator("[data-robot='one']")).to_contain_text("ready")
            expect(page.locator("#stop")).to_have_attribute("aria-disabled", "true")
            page.keyboard.press("Escape")
            expect(page.locator("#notices")).to_contain_text("STOP was not sent")
            assert fleet["one"].stopped_because is None
        with open_page(dashboard.link) as page:
            connected(page)
            assert token not in page.url
            page.reload()  # the tab keeps it
            connected(page)
            page.keyboard.press("Escape")
            expect(page.locator("#stopped")).to_be_visible()


def test_an_operator_signs_in_by_https_and_stops_the_robots(open_page: OpenPage, fleet: Fleet, tmp_path: Path) -> None:
    make_authority(tmp_path / "keys", "counted")
    made = make_certificate(tmp_path / "keys", "dashboard", ["127.0.0.1"])
    anna = OperatorSection(role="drive", token=hash_token("the-token"))
    with (
        Dashboard(
            fleet,
            Access("127.0.0.1", operators={"anna": anna}),
            tls=tls_context(made.file, key_file(tmp_path / "keys", "dashboard")),
        ) as dashboard,
        open_page(dashboard.link, ignore_https_errors=True) as page,
    ):
        dialog = page.locator("#sign-in")
        expect(dialog).to_contain_text("sign in with your token")
        expect(page.locator("#fleet-name")).to_have_text("eal")  # nothing of the fleet is shown
        for _ in range(WRONG_TOKENS):
            page.get_by_label("Token").fill("anna.wrong")
            page.get_by_label("Token").press("Enter")
            expect(dialog).to_contain_text("wrong token")
        page.get_by_label("Token").fill("anna.the-token")
        page.get_by_label("Token").press("Enter")
        expect(dialog).to_contain_text("too many wrong tokens from 127.0.0.1: try again in")
        dashboard.app_state.sign_in._wrong.clear()  # as after a minute
        page.get_by_label("Token").fill("anna.the-token")
        page.get_by_label("Token").press("Enter")
        connected(page)
        expect(page.locator("#user")).to_have_text("anna · drive")
        page.reload()  # the tab keeps the token
        connected(page)
        page.keyboard.press("Escape")
        expect(page.locator("#stopped")).to_contain_text("All robots refuse to move")
        go(page, "scenario")
        expect(page.get_by_role("button", name="Start", exact=True)).to_be_disabled()


def test_the_tab_of_an_operator_who_may_only_watch_keeps_the_token(open_page: OpenPage, fleet: Fleet) -> None:
    ben = OperatorSection(role="watch", token=hash_token("the-token"))
    with (
        Dashboard(fleet, Access("127.0.0.1", operators={"ben": ben})) as dashboard,
        open_page(dashboard.link) as page,
    ):
        page.get_by_label("Token").fill("ben.the-token")
        page.get_by_label("Token").press("Enter")
        expect(page.locator("#user")).to_have_text("ben · watch")
        page.reload()
        expect(page.locator("#user")).to_have_text("ben · watch")


# A robot's panel.


def test_the_panel_checks_ranges_and_shows_robots_texts_as_text(open_page: OpenPage, dashboard: Dashboard) -> None:
    with open_page(dashboard.link + "#/robot/one") as page:
        degrees = page.get_by_label("turn<degrees>", exact=True)
        form = page.locator("form", has=degrees)
        degrees.fill("400")
        degrees.press("Enter")
        expect(form.locator("output")).to_have_text("must be a number from 0 to 360 deg")
        degrees.fill("90")
        form.get_by_role("button").click()
        expect(form.locator("output")).to_have_text("✓ 1")
        failing = page.locator("form", has=page.locator("code", has_text=re.compile("^fail$")))
        failing.get_by_role("button").click()
        expect(failing.locator("output")).to_contain_text("<b>wheel</b> fell off")
        go(page, "fleet")
        expect(page.locator("tr[data-robot='one']")).to_contain_text("<b>wheel</b> fell off")
        assert page.locator("main b", has_text="wheel").count() == 0
