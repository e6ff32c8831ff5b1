"""`eal run --lookahead`: two robots that drive towards each other are warned, and held if that is asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.lab.lookahead.watching import Lookahead
from tests.plugin_files import write_plugin

FLEET = """\
version: 1
name: two
seed: 3
clock: {rate: max}
world: empty
types: {mover: {plugins: {sim: {model: evbot2}}}}
robots:
  ann: {type: mover, plugins: {sim: {start: {x_m: -1.5, y_m: 0, yaw_deg: 0}}}}
  bob: {type: mover, plugins: {sim: {start: {x_m: 1.5, y_m: 0, yaw_deg: 180}}}}
"""
SCENARIO = """\
version: 1
name: crash
roles: {all: {}}
timeout_s: 30
steps:
  - on: all
    do: [{send_cmd: {resource: Base, cmd: f1.5}}]
"""


AGAIN = SCENARIO.replace("timeout_s: 30\n", "timeout_s: 30\non_failure: skip\n").replace(
    "cmd: f1.5}}]", "cmd: f1.5}}, {send_cmd: {resource: Base, cmd: f1.2}}]"
)
"""Its robots go on after a step that failed."""


def run(
    eal: Any, folder: Path, *options: str, scenario: str = SCENARIO, code: int = 1
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the warnings and the summary of a run."""
    (folder / "fleet.yaml").write_text(FLEET)
    (folder / "crash.yaml").write_text(scenario)
    words = ("--fleet", folder / "fleet.yaml", "--no-plot", "--runs-dir", folder / "runs", *options)
    result = eal("run", folder / "crash.yaml", *words)
    assert result.exit_code == code, result.output
    (record,) = (folder / "runs").iterdir()
    events = [json.loads(line) for line in (record / "events.jsonl").read_text().splitlines()]
    warnings = [event for event in events if event["event"] == "log" and event["text"].startswith("look-ahead")]
    return warnings, json.loads((record / "summary.json").read_text())


def test_a_contact_is_foretold(eal: Any, tmp_path: Path) -> None:
    warnings, summary = run(eal, tmp_path, "--lookahead", "10")
    assert "will touch bob" in warnings[0]["text"]
    assert summary["contacts"][0]["time_s"] - warnings[0]["time_s"] > 2


def test_held_robots_do_not_touch(eal: Any, tmp_path: Path) -> None:
    warnings, summary = run(eal, tmp_path, "--lookahead", "10", "--lookahead-hold")
    assert warnings[-1]["text"].endswith("halted: ann, bob")
    assert summary["contacts"] == []


def test_robots_that_go_on_are_held_again(eal: Any, tmp_path: Path) -> None:
    warnings, summary = run(eal, tmp_path, "--lookahead", "10", "--lookahead-hold", scenario=AGAIN, code=0)
    assert sum("halted" in warning["text"] for warning in warnings) >= 2
    assert summary["contacts"] == []


@pytest.mark.parametrize(("way_m", "is_held"), [(5.0, True), (1.75, False)])
def test_a_robot_is_held_before_a_wall_only_if_it_drives_into_it(
    eal: Any, tmp_path: Path, way_m: float, *, is_held: bool
) -> None:
    move = f"l90}}}}, {{send_cmd: {{resource: Base, cmd: f{way_m}"
    scenario = SCENARIO.replace("{all: {}}", "{all: {max: 1}}").replace("f1.5", move)
    warnings, summary = run(eal, tmp_path, "--lookahead", "3", "--lookahead-hold", scenario=scenario, code=int(is_held))
    assert any(warning["text"].endswith("halted: ann") for warning in warnings) == is_held
    assert summary["contacts"] == []


@pytest.mark.parametrize("options", [("--lookahead-hold",), ("--lookahead", "0.5")])
def test_wrong_options_are_refused(eal: Any, tmp_path: Path, options: tuple[str, ...]) -> None:
    (tmp_path / "fleet.yaml").write_text(FLEET)
    (tmp_path / "crash.yaml").write_text(SCENARIO)
    assert eal("run", tmp_path / "crash.yaml", "--fleet", tmp_path / "fleet.yaml", *options).exit_code == 2


POSE = """
from eal_actors.plugin import *

class Pose(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape={shape})

    def get_value(self):
        return EALData.of({value})
"""


def test_a_robot_with_a_strange_pose_ends_no_look_ahead_for_the_others(tmp_path: Path) -> None:
    write_plugin(tmp_path, "flat", POSE.format(shape="(2,)", value="[1.0, 2.0]"), "Pose")
    write_plugin(tmp_path, "honest", POSE.format(shape="(3,)", value="[1.0, 2.0, 0.0]"), "Pose")
    robots: dict[str, object] = {name: {"plugins": {name: {}}} for name in ("flat", "honest")}
    content = {"version": 1, "name": "f", "clock": {"rate": "max"}, "plugin_dirs": ["plugins"], "robots": robots}
    (tmp_path / "f.yaml").write_text(json.dumps(content))
    looks: list[float] = []
    with Fleet.load(tmp_path / "f.yaml") as fleet:
        begin_s = fleet.clock.now()
        with Lookahead(fleet, tuple(fleet), {}, on_look=lambda time_s, _: looks.append(time_s - begin_s)):
            fleet.clock.sleep(3.5)
    assert looks == pytest.approx([1, 2, 3])
