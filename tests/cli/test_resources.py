"""`eal resources`."""

import json
from pathlib import Path
from typing import Any

from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.bundled import bundled_path


def test_it_shows_methods_commands_units_and_ranges(eal: Any, slides: Path) -> None:
    result = eal("resources", "--fleet", slides, "--robot", "one")
    assert result.exit_code == 0
    heading, _, _, _, *rows = result.stdout.splitlines()
    assert heading == "one  ready  tags wide"
    text = "\n".join(rows)
    for word in ("sensor", "actuator", "get_config", "command to<metres> (double 0..1 m)", "command s (stop)"):
        assert word in text
    assert "config speed_m_s (double 0.01..0.5 m/s)" in text
    assert "two" not in result.stdout


def test_robots_that_offer_the_same_share_a_table(eal: Any, write: Any) -> None:
    fleet = write("many.yaml", "version: 1\nrobots:\n  bot{n}: {count: 12, plugins: {sample: {}}}\n")
    lines = eal("resources", "--fleet", fleet).stdout.splitlines()
    assert lines[0] == "bot1 to bot12 (12 robots)  ready"
    assert sum("SampleResource" in line for line in lines) == 1
    sim = eal("resources", "--fleet", bundled_path("fleets/sim.yaml")).stdout.splitlines()
    assert [line.split()[:4] for line in sim if " ready " in line] == [
        [f"{make}-1", "ready", "type", make] for make in ("evbot2", "evbot3", "roomba")
    ]
    assert sum(line.startswith("Base ") for line in sim) == 3, "each make has its own"


def test_it_fits_into_80_columns(eal: Any, monkeypatch: Any) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = eal("resources", "--fleet", bundled_path("fleets/sim.yaml")).stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)


def test_json_holds_the_whole_information(eal: Any, slides: Path) -> None:
    result = eal("resources", "--fleet", slides, "--json")
    found = json.loads(result.stdout)
    assert [(robot["name"], robot["state"]) for robot in found["robots"]] == [("one", "ready"), ("two", "ready")]
    info = ResourceInfo.from_dict(found["robots"][0]["resources"][0])
    assert (info.name, info.config("speed_m_s").value.unit) == ("Slide", "m/s")


def test_a_robot_that_does_not_come_up_tells_why(eal: Any, half_dead: Path) -> None:
    result = eal("resources", "--fleet", half_dead)
    assert result.exit_code == 3
    assert "plugin 'dead': connect raised OSError: no such port" in result.stdout
    assert "one  ready" in result.stdout
    robots = json.loads(eal("resources", "--fleet", half_dead, "--json").stdout)["robots"]
    assert [bool(robot["problems"]) for robot in robots] == [False, True]


def test_a_resource_that_cannot_open_tells_why(eal: Any, slides: Path) -> None:
    plugin = slides.parent / "plugins" / "slide" / "plugin.py"
    text = plugin.read_text(encoding="utf-8")
    broken = text.replace(
        "def __init__(self)", "def open(self):\n        raise OSError('brake on')\n\n    def __init__(self)"
    )
    plugin.write_text(broken, encoding="utf-8")
    fleet = slides.read_text(encoding="utf-8").replace("version: 1", "version: 1\ndefaults: {restart: temporary}")
    slides.write_text(fleet, encoding="utf-8")
    result = eal("resources", "--fleet", slides, "--robot", "two")
    assert result.exit_code == 3
    assert "brake on" in result.stdout
