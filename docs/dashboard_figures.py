"""Make the pictures of the dashboard: `make figures`, or `python docs/dashboard_figures.py`. They show live robots."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from eal_actors import Fleet, gather
from eal_actors.device.world import load_world
from eal_actors.managers.config import EALConfigManager
from eal_actors.operate.dashboard import Dashboard
from tests.chromium import FLAGS, find_chromium
from tests.operate.agents.waiting_plan import keep_plan

ROOT: Final = Path(__file__).parents[1]
IMAGES: Final = ROOT / "docs/images"
VIEWS: Final = ("mission", "scenario", "fleet", "map", "robot/evbot3-1", "cameras", "logs")
SIZES: Final = ((1440, 900), (1024, 768), (768, 1024), (390, 844))
SHEET_PX: Final = 560
"""The height of a page on the sheet of sizes."""
SETTLE_MS: Final = 2500
HALL: Final = """\
version: 1
name: hall
size_m: [6, 4]
obstacles: [{kind: wall, start_m: [0, -2], end_m: [0, 0.6]}]
places: {dock: {x_m: 2.0, y_m: -1.0}}
"""
ZONE: Final = ((-1.6, 0.7), (-0.8, 0.7), (-0.8, 1.9), (-1.6, 1.9))


def open_page(browser: Browser, link: str, width: int = 1280, height: int = 720, *, is_dark: bool = False) -> Page:
    """Open a page of the dashboard."""
    scheme: Final = "dark" if is_dark else "light"
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    page.goto(link)
    return page


@contextmanager
def dancing_lab() -> Iterator[tuple[Fleet, Dashboard]]:
    """Open the shipped fleet in the laboratory, and its dashboard."""
    lab = load_world(ROOT / "fleets/worlds/lab.yaml")
    config = replace(EALConfigManager.load(ROOT / "fleets/sim.yaml").fleet, world=lab)
    with Fleet(config).connect() as fleet, Dashboard(fleet, scenarios=ROOT / "scenarios") as dashboard:
        for robot in fleet.values():
            robot["Base"].set_config("step_m", 0.6).get()
        yield fleet, dashboard


def start_square(page: Page) -> None:
    """Run the square from the page, once more."""
    page.evaluate("location.hash = '#/scenario'")
    page.get_by_label("Scenario", exact=True).first.select_option("square.yaml")
    page.get_by_role("button", name="Start", exact=True).click()


def show(page: Page, view: str) -> None:
    """Show a view, with frames in its cameras."""
    page.evaluate("(view) => { location.hash = `#/${view}`; }", view)
    page.wait_for_selector("[data-frames]" if view in ("mission", "cameras") else "h1", state="attached")
    page.wait_for_timeout(SETTLE_MS)


def draw_views(browser: Browser) -> None:
    """Draw each view while robots drive a square, some of them dark or on a phone."""
    with dancing_lab() as (_, dashboard):
        page = open_page(browser, f"{dashboard.link}#/mission", 1440, 860)
        show(page, "mission")  # the first frames of cameras take longest
        dark = open_page(browser, f"{dashboard.link}#/map", 1440, 860, is_dark=True)
        start_square(page)
        for view in VIEWS:
            show(page, view)
            page.screenshot(path=IMAGES / f"dashboard-{view.partition('/')[0]}.png")
            if view == "map":
                dark.screenshot(path=IMAGES / "dashboard-dark.png")
        for name, view in (("phone", "robot/roomba-1"), ("mission-phone", "mission")):
            phone = open_page(browser, dashboard.link, 390, 780)
            show(phone, view)
            phone.screenshot(path=IMAGES / f"dashboard-{name}.png")


def draw_sizes(browser: Browser) -> None:
    """Draw mission control in four sizes side by side, light above dark."""
    rows = []
    with dancing_lab() as (_, dashboard):
        for is_dark in (False, True):
            row: list[Any] = []
            for width, height in SIZES:
                page = open_page(browser, dashboard.link, width, height, is_dark=is_dark)
                if not row:
                    start_square(page)
                show(page, "mission")
                picture = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
                if picture is None:
                    raise RuntimeError("the browser made no picture")
                size = (round(width * SHEET_PX / height), SHEET_PX)
                row.append(
                    cv2.copyMakeBorder(
                        cv2.resize(picture, size, interpolation=cv2.INTER_AREA),
                        6,
                        6,
                        6,
                        6,
                        cv2.BORDER_CONSTANT,
                        value=(136, 136, 136),
                    )
                )
                page.close()
            rows.append(np.hstack(row))
    cv2.imwrite(str(IMAGES / "dashboard-sizes.png"), np.vstack(rows))


def draw_send(browser: Browser, folder: Path) -> None:
    """Draw a robot that was sent round a wall and a drawn zone."""
    (folder / "hall.yaml").write_text(HALL)
    robot = "rover: {plugins: {sim: {model: roomba, start: {x_m: -2, y_m: -1, yaw_deg: 90}}}}"
    (folder / "fleet.yaml").write_text(f"version: 1\nname: sent\nseed: 4\nworld: hall.yaml\nrobots:\n  {robot}\n")
    with Fleet.load(folder / "fleet.yaml").connect() as fleet, Dashboard(fleet) as dashboard:
        fleet["rover"]["Base"].set_config("max_uncertainty_m", 1.0).get()
        page = open_page(browser, f"{dashboard.link}#/map", 1200, 800)
        page.get_by_label("Send", exact=True).select_option("rover")
        canvas = page.locator(".map canvas")
        box = canvas.bounding_box()
        if box is None:
            raise RuntimeError("the map is not on the page")
        scale = min(box["width"] / 6, box["height"] / 4) * 0.94

        def click(x_m: float, y_m: float) -> None:
            canvas.click(position={"x": box["width"] / 2 + x_m * scale, "y": box["height"] / 2 - y_m * scale})

        page.get_by_role("button", name="Draw a keep-out zone").click()
        for corner in ZONE:
            click(*corner)
        page.get_by_role("button", name="Close the zone").click()
        click(-2.0, 1.2)
        page.get_by_text("rover is at (-2.0").wait_for(timeout=60_000)
        click(2.0, -1.0)
        page.wait_for_timeout(SETTLE_MS)
        page.screenshot(path=IMAGES / "dashboard-send.png")


def draw_floor(browser: Browser) -> None:
    """Draw the arena with the picture of its floor beneath the map."""
    with Fleet.load(ROOT / "fleets/arena.yaml").connect() as fleet, Dashboard(fleet) as dashboard:
        gather([fleet[name]["Base"].send_cmd("l30") for name in fleet if name != "cameras-1"]).get()
        page = open_page(browser, f"{dashboard.link}#/map", 1200, 800)
        page.wait_for_selector(".map canvas[data-floors]:not([data-floors='0'])", timeout=60_000)
        page.wait_for_timeout(SETTLE_MS)
        page.screenshot(path=IMAGES / "dashboard-floor.png")


def draw_plan(browser: Browser, folder: Path) -> None:
    """Draw a plan of an agent that waits for a decision; its text tries to look approved."""
    hashed = keep_plan(folder, "sim").hash
    with Fleet.load(ROOT / "fleets/sim.yaml").connect() as fleet, Dashboard(fleet, runs_dir=folder) as dashboard:
        page = open_page(browser, f"{dashboard.link}#/scenario", 1100, 900)
        page.get_by_role("button", name=f"Approve {hashed[:6]}").wait_for()
        page.screenshot(path=IMAGES / "agent-plan.png")


def draw_dashboard() -> None:
    """Make every picture, where a Chromium is installed."""
    program = find_chromium()
    if program is None:
        print("no Chromium is installed: the pictures of the dashboard stay as they are")  # noqa: T201
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=program, args=list(FLAGS)) as browser,
    ):
        draw_views(browser)
        draw_sizes(browser)
        draw_send(browser, Path(folder))
        draw_floor(browser)
        draw_plan(browser, Path(folder))


if __name__ == "__main__":
    draw_dashboard()
