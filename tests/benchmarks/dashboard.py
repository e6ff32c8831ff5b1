"""Updates a second that reach the dashboard, and frames a second that Chromium draws, while a hundred robots drive."""

from __future__ import annotations

import math
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from playwright.sync_api import Page, sync_playwright

from eal_actors import Fleet
from eal_actors.operate.dashboard import Dashboard
from tests.benchmarks.result import Result, Skipped
from tests.chromium import FLAGS, MISSING, find_chromium

TWIST: Final = (0.2, 0.5)
"""m/s and rad/s: each robot drives in its own circle and meets no other robot."""
ROBOTS: Final = 100
CAMERAS: Final = 4
SPACING_M: Final = 2.5
DRIVE_S: Final = 60.0
FIRST_FRAME_MS: Final = 60_000
SETTLE_MS: Final = 4000
WINDOW_MS: Final = 2000
"""Over which the page counts."""
WINDOWS: Final = 5
LEAST: Final = 20
LEAST_SHARE: Final = 0.95
"""Of the frames that an empty page of the same browser draws, 60 a second at most. Chromium draws without a GPU, on the
processors that simulate the robots."""
VIEWS: Final = {
    "mission": f"updates a second in mission control, {ROBOTS} robots driving",
    "fleet": f"updates a second in the dashboard's table of {ROBOTS} driving robots",
    "map": f"updates a second in the dashboard's map, {ROBOTS} robots driving",
    "cameras": f"the same beside {CAMERAS} open cameras at 5 frames/s each",
}
COUNT_FRAMES: Final = """(ms) => new Promise((resolve) => {
    let frames = -1;
    const begin = performance.now();
    const count = (now) => {
        frames += 1;
        if (now - begin < ms) requestAnimationFrame(count);
        else resolve((1000 * frames) / (now - begin));
    };
    requestAnimationFrame(count);
})"""


def fleet_file(folder: Path) -> Path:
    """Write a fleet of robots in a grid, some of them with cameras that the page opens by itself; return the file."""
    side = math.ceil(math.sqrt(ROBOTS))
    (folder / "hall.yaml").write_text(f"version: 1\nname: hall\nsize_m: [{side * 3}, {side * 3}]\n")
    lines = ["version: 1", "name: hundred", "world: hall.yaml", "robots:"]
    for number in range(ROBOTS):
        row, column = divmod(number, side)
        x_m, y_m = ((place - (side - 1) / 2) * SPACING_M for place in (column, row))
        model = "evbot2" if number < CAMERAS else "roomba"
        start = f"{{x_m: {x_m}, y_m: {y_m}, yaw_deg: 0}}"
        lines.append(f"  robot{number + 1}: {{plugins: {{sim: {{model: {model}, start: {start}}}}}}}")
    fleet = folder / "fleet.yaml"
    fleet.write_text("\n".join(lines) + "\n")
    return fleet


def drive(fleet: Fleet) -> None:
    """Set every robot off, for longer than a view is measured."""
    for robot in fleet.values():
        robot["Base"].set_config("twist_timeout_s", DRIVE_S).get()
    for robot in fleet.values():
        robot["Base"].set_value(TWIST, timeout_s=2 * DRIVE_S)  # answered when it ends


def open_cameras(page: Page) -> None:
    """Open so many cameras, and no others; return when each has shown a frame."""
    boxes = page.locator("main input[type=checkbox]")
    boxes.first.wait_for()
    for box in boxes.all():
        box.uncheck()
    for box in boxes.all()[:CAMERAS]:
        box.check()
    page.locator("[data-frames]").nth(CAMERAS - 1).wait_for(timeout=FIRST_FRAME_MS)


def rates(page: Page) -> tuple[Sequence[float], Sequence[float]]:
    """Return the updates a second that the page counted, and the frames a second that it drew, window by window."""
    updates, frames = [], []
    for _ in range(WINDOWS):
        frames.append(float(page.evaluate(COUNT_FRAMES, WINDOW_MS)))
        updates.append(float(page.evaluate("document.body.dataset.rate")))
    return updates, frames


def empty_rate(page: Page) -> float:
    """Return the frames a second that the browser draws of an empty page while the robots drive on."""
    empty = page.context.new_page()
    empty.bring_to_front()
    frames = float(empty.evaluate(COUNT_FRAMES, WINDOW_MS))
    empty.close()
    page.bring_to_front()
    return frames


def result(what: str, counted: Sequence[float], unit: str, limit: float) -> Result:
    """Return the mean of the windows, held against the limit."""
    mean = statistics.fmean(counted)
    least = f"least of {len(counted)} windows of {WINDOW_MS / 1000:g} s: {min(counted):.1f}"
    return Result(what, f"{mean:.1f}", least, mean, limit, unit, at_least=True)


def run() -> list[Result | Skipped]:
    """Measure five windows of two seconds in each view; their mean counts."""
    program = find_chromium()
    if program is None:
        return [Skipped(what, MISSING) for what in VIEWS.values()]
    results: list[Result | Skipped] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        Fleet.load(fleet_file(Path(folder))) as fleet,
        Dashboard(fleet) as dashboard,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        page = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
        for view, what in VIEWS.items():
            page.goto(f"{dashboard.link}#/{view}")
            if view == "cameras":
                open_cameras(page)
            drive(fleet)
            page.wait_for_timeout(SETTLE_MS)
            updates, frames = rates(page)
            results.append(result(what, updates, "updates/s", LEAST))
            drawn, empty = statistics.fmean(frames), empty_rate(page)
            what = f"frames a second drawn in the view {view}"
            reference = f"an empty page: {empty:.1f}; least of {WINDOWS} windows: {min(frames):.1f}"
            results.append(Result(what, f"{drawn:.1f}", reference, drawn / empty, LEAST_SHARE, at_least=True))
        browser.close()
    return results
