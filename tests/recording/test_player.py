"""The player of a report, in Chromium: where the robots are, the keys, and a long run of many robots."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, sync_playwright

from eal_actors.recording import RunFolder, render_report
from eal_actors.recording.picture import draw_map
from eal_actors.recording.poses import PoseSample
from tests.chromium import FLAGS, MISSING, find_chromium

ROBOTS, MINUTES, PERIOD_S = 20, 10, 0.1
MOST_BYTES = 15_000_000


def test_the_coordinates_of_the_map_are_those_of_its_drawing() -> None:
    """The first and the last point of a straight path, as matplotlib writes them, in points."""
    path = [PoseSample(float(t), 0.5 * t, -0.25 * t, 0.0) for t in range(3)]
    picture = draw_map({"a": path}, None)
    assert picture is not None
    drawn = re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", picture.svg)
    for end in (path[0], path[-1]):
        wanted = picture.zero_x + end.x_m * picture.scale_x, picture.zero_y - end.y_m * picture.scale_y
        assert any(math.dist(wanted, (float(x), float(y))) < 0.01 for x, y in drawn), wanted


@pytest.fixture
def page() -> Iterator[Page]:
    program = find_chromium()
    if program is None:
        pytest.skip(MISSING)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        page = browser.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page
        browser.close()
    assert not errors


def long_run(folder: Path) -> RunFolder:
    """Write the record of a run of ten minutes with twenty robots that never stand still."""
    folder.mkdir()
    names, end_s = [f"robot-{number}" for number in range(ROBOTS)], MINUTES * 60.0
    started = {"event": "run_started", "time_s": 0.0, "scenario": "long", "fleet": "many", "robots": names}
    record: dict[str, Any] = {"role": "all", "branch": None, "kind": "send_cmd", "resource": "Base", "command": "f"}
    record |= {"outcome": "done", "attempts": 1, "error": None, "label": "send_cmd Base f"}
    events = [started]
    for at_s in range(0, MINUTES * 60, 5):
        for name in names:
            step = {**record, "robot": name, "step": "steps[0]", "start_s": float(at_s), "end_s": at_s + 5.0}
            events.append({"event": "step_ended", "time_s": at_s + 5.0, "record": step})
    (folder / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    lines = ["robot,time_s,x_m,y_m,yaw_rad"]
    for index in range(int(end_s / PERIOD_S)):
        time_s = index * PERIOD_S
        for number, name in enumerate(names):
            angle = time_s / 20 + number
            x_m, y_m = (1 + 0.1 * number) * math.cos(angle), (1 + 0.1 * number) * math.sin(angle)
            lines.append(f"{name},{time_s:.3f},{x_m:.6f},{y_m:.6f},{angle + math.pi / 2:.6f}")
    (folder / "trajectory.csv").write_text("\n".join(lines) + "\n")
    return RunFolder.open(folder)


@pytest.mark.slow
def test_ten_minutes_of_twenty_robots_are_a_small_page_that_moves(tmp_path: Path, page: Page) -> None:
    run = long_run(tmp_path / "run")
    file = tmp_path / "report.html"
    file.write_text(render_report(run), encoding="utf-8")
    size = file.stat().st_size
    assert size < MOST_BYTES
    page.goto(file.as_uri())
    page.keyboard.press("End")
    marker = page.locator("#map svg > g:has(circle)").first.get_attribute("transform")
    data = json.loads(page.locator("#player-data").text_content() or "")
    zero_x, zero_y, scale_x, scale_y = data["map"]
    last = run.paths["robot-0"][-1]
    wanted = f"translate({zero_x + last.x_m * scale_x:.2f} {zero_y - last.y_m * scale_y:.2f})"
    shown = [float(word) for word in str(marker).removeprefix("translate(").removesuffix(")").split()]
    assert shown == pytest.approx([float(word) for word in wanted[10:-1].split()], abs=0.1)
    frames = page.evaluate(
        """() => new Promise((done) => {
            let frames = 0; const start = performance.now();
            document.getElementById('player-play').click();
            const count = () => { frames += 1; const took = performance.now() - start;
                if (took > 2000) done(frames / took * 1000); else requestAnimationFrame(count); };
            requestAnimationFrame(count); })"""
    )
    print(f"{size / 1e6:.2f} MB, {frames:.0f} frames/s")  # noqa: T201  # shown with -s
    assert frames > 0
