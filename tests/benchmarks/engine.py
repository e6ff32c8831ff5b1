"""The scenario engine's own cost per robot and step, with 100 robots whose command returns at once."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from eal_actors import Fleet, gather
from eal_actors.scenario import load_scenario, run_scenario
from tests.benchmarks.result import Result

ROBOTS = 100
STEPS = 20

PLUGIN = '''
from eal_actors.plugin import EALPlugin, Resource, ResourceType, command

class Lamp(Resource):
    """A resource with one command."""
    types = ResourceType.OTHER
    @command("on")
    def on(self): return 1

def connect(): return EALPlugin("Lamp")
def disconnect(plugin): pass
def create_Lamp(): return Lamp()
def destroy_Lamp(resource): pass
'''
MANIFEST = 'version: 1\nname: lamp\ndescription: A lamp.\nplugin_version: "1"\nresources: [Lamp]\n'
FLEET = f'version: 1\nplugin_dirs: [plugins]\nrobots: {{"robot{{n}}": {{count: {ROBOTS}, plugins: {{lamp: {{}}}}}}}}\n'
SCENARIO = f"""\
version: 1
name: lamps
description: Every robot switches its lamp on, again and again, together.
roles: {{all: {{}}}}
steps:
  - repeat: {STEPS}
    do:
      - on: all
        do:
          - send_cmd: {{resource: Lamp, cmd: "on"}}
"""


def run() -> list[Result]:
    """Measure five runs, each beside the same calls made by hand; the difference is the engine's own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "plugins/lamp").mkdir(parents=True)
        (folder / "plugins/lamp/plugin.py").write_text(PLUGIN)
        (folder / "plugins/lamp/plugin.yaml").write_text(MANIFEST)
        (folder / "fleet.yaml").write_text(FLEET)
        (folder / "scenario.yaml").write_text(SCENARIO)
        scenario = load_scenario(folder / "scenario.yaml")
        engine_s, by_hand_s = [], []
        with Fleet.load(folder / "fleet.yaml") as fleet:
            lamps = [robot["Lamp"] for robot in fleet.values()]
            for turn in range(5):
                start = time.perf_counter()
                report = run_scenario(scenario, fleet, directory=folder / f"run{turn}")
                engine_s.append(time.perf_counter() - start)
                if report.outcome != "done":
                    raise AssertionError(report.error)
                start = time.perf_counter()
                for _ in range(STEPS):
                    gather([lamp.send_cmd("on") for lamp in lamps]).get()
                by_hand_s.append(time.perf_counter() - start)
    each = ROBOTS * STEPS
    whole_ms, hand_ms = (1e3 * statistics.median(times) / each for times in (engine_s, by_hand_s))
    return [
        Result(
            "engine's own cost per robot and step, 100 robots, recorded",
            f"{whole_ms:.3f} ms with the call",
            f"the calls by hand: {hand_ms:.3f} ms",
            whole_ms - hand_ms,
            0.5,
            "ms",
        )
    ]
