"""The reference page of scenario files: its examples fit the simulated fleet, and it names every key."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors.device.world import load_world
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario, make_plan, scenario_schema

PAGE = (Path(__file__).parents[2] / "docs/scenarios.md").read_text()
BLOCKS = [match.group(1) for match in re.finditer(r"^```yaml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)]
HEAD = "version: 1\nname: example\n"
ROLES = "roles:\n  scouts: {types: [evbot2, evbot3]}\n  carriers: {types: [roomba]}\n"
OTHER = (
    f"{HEAD}parameters: {{legs: {{type: int}}}}\nroles: {{drivers: {{}}}}\n"
    "steps: [{repeat: '${legs}', do: [{log: x}]}, {signal: through}]\n"
)


@pytest.fixture
def sim() -> Iterator[Fleet]:
    config = EALConfigManager.load(bundled_path("fleets/sim.yaml")).fleet
    world = load_world(bundled_path("fleets/worlds/lab.yaml"))  # it has places
    with Fleet(replace(config, rate="max", world=world)) as fleet:
        yield fleet


def completed(block: str) -> str:
    """Return the file that an example is a part of."""
    if block.startswith("version:"):
        return block
    if block.startswith("- "):
        return f"{HEAD}{ROLES}steps:\n{block}"
    text = HEAD + block
    text += "" if "\nroles:" in text else ROLES
    return text if "\nsteps:" in text else f"{text}steps: [{{log: x}}]\n"


@pytest.mark.parametrize("block", BLOCKS, ids=[f"example{number}" for number in range(len(BLOCKS))])
def test_every_example_fits_the_simulated_fleet(block: str, sim: Fleet, tmp_path: Path) -> None:
    (tmp_path / "example.yaml").write_text(completed(block))
    (tmp_path / "other.yaml").write_text(OTHER)
    given = {"legs": 2} if "legs: {type: int}" in block else {}

    plan = make_plan(load_scenario(tmp_path / "example.yaml", given), sim)

    assert plan.roles


def keys_of_the_language() -> set[str]:
    schema = scenario_schema()
    sections = [schema, *schema["$defs"].values()]
    return {key for section in sections for key in section.get("properties", {})}


def test_the_page_names_every_key() -> None:
    missing = {key for key in keys_of_the_language() if not re.search(rf"\b{re.escape(key)}\b", PAGE)}
    assert not missing


def test_every_key_stands_in_an_example() -> None:
    in_tables = {
        "send_req",
        "req",
        "read_comm",
        "write_comm",
        "length",
        "data",
        "get_status",
        "set_value",
        "factor",
        "tags",
    }
    missing = {key for key in keys_of_the_language() if not re.search(rf"\b{re.escape(key)}:\s", "\n".join(BLOCKS))}
    assert missing <= in_tables
