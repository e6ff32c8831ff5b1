"""The shipped notebook runs in a real kernel, and its map follows the fleet."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import expect

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from tests.chromium import launched_chromium

pytestmark = pytest.mark.slow


@pytest.mark.timeout(400)
def test_the_notebook_runs_and_shows_table_numbers_and_picture(tmp_path: Path) -> None:
    nbformat = pytest.importorskip("nbformat")
    notebook = tmp_path / "first-fleet.ipynb"
    notebook.write_bytes(bundled_path("docs/notebooks/first-fleet.ipynb").read_bytes())
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--nbmake", "--overwrite"]
    done = subprocess.run([*command, str(notebook)], cwd=tmp_path, capture_output=True, text=True, timeout=380)
    assert done.returncode == 0, done.stdout + done.stderr
    cells = nbformat.read(notebook, as_version=4).cells
    shown = [output["data"] for cell in cells for output in cell.get("outputs", []) if "data" in output]
    kinds = {kind for data in shown for kind in data}
    assert {"text/html", "image/png", "application/vnd.jupyter.widget-view+json"} <= kinds
    assert "PoseEstimate(x_m=" in json.dumps(shown)


def test_the_map_follows_the_fleet_and_stops_it() -> None:
    from eal_actors.operate.notebook import FleetMap

    with Fleet.load("sim") as fleet:
        fleet_map = FleetMap(fleet)
        assert fleet_map.poses["roomba-1"] == pytest.approx([1.5, 0, 0])
        fleet["roomba-1"].base.turn(45).get()
        fleet_map.update()
        assert fleet_map.poses["roomba-1"][2] > 0.5
        fleet_map.stop_robots()
        while not all(robot.is_stop_confirmed for robot in fleet.values()):
            fleet.clock.sleep(0.05)
        fleet_map.update()
        assert set(fleet_map.states.values()) == {"emergency stop"}
        fleet_map.close()


def test_the_stop_button_says_what_is_confirmed() -> None:
    from eal_actors.operate.notebook import FleetMap

    script = str(FleetMap._esm).replace("export default { render };", "")
    page_text = f"""<div id=map></div><script type=module>{script}
        const values = {{ world: null, poses: {{}}, states: {{ one: "ready", two: "lost" }} }}, listeners = {{}};
        window.change = (states) => {{ values.states = states; listeners["change:states"](); }};
        const model = {{ get: (name) => values[name], on: (name, call) => (listeners[name] = call), send() {{}} }};
        render({{ model, el: document.getElementById("map") }});</script>"""
    with launched_chromium() as browser:
        page = browser.new_page()
        page.set_content(page_text)
        line = page.get_by_role("status")
        expect(line).to_have_text("1 ready; 1 lost (two)")
        page.get_by_role("button", name="STOP all robots").click()
        expect(line).to_contain_text("STOP sent, NOT CONFIRMED")
        page.evaluate("change({ one: 'emergency stop', two: 'stop NOT CONFIRMED' })")
        expect(line).to_have_text("1 emergency stop (one); 1 stop NOT CONFIRMED (two)")
        page.evaluate("change({})")
        expect(line).to_contain_text("The fleet is closed")
