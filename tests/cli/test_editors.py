"""Editors and shells: schemas with the installed plugins, `eal init`, headers of new files, completion."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest

from eal_actors.cli.check import schema_of
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.yaml_source import load_yaml
from tests.cli.conftest import Program, Write


def problems(text: str) -> list[str]:
    validator = jsonschema.Draft202012Validator(schema_of("fleet"))
    return [error.json_path for error in validator.iter_errors(json.loads(text))]


def test_the_schema_of_fleets_knows_the_settings_of_plugins() -> None:
    robot = '{"version": 1, "name": "x", "robots": {"a": {"plugins": %s}}}'
    assert problems(robot % '{"sim": {"model": "roomba"}}') == []
    assert problems(robot % '{"sim": {"model": "romba"}}') == ["$.robots.a.plugins.sim.model"]
    assert problems(robot % '{"body": {"plugin": "sim", "model": "romba"}}') == ["$.robots.a.plugins.body.model"]
    assert problems(robot % '{"sim": {"model": "${MODEL}"}}') == []
    assert problems(robot % '{"sim": {"modle": "roomba"}}') == ["$.robots.a.plugins.sim"]
    assert problems(robot % '{"of_others": {"any": 1}}') == []


def test_every_bundled_fleet_fits_that_schema() -> None:
    schema = schema_of("fleet")
    assert schema["$id"].endswith("/schemas/fleet/1.json")
    validator = jsonschema.Draft202012Validator(schema)
    wrong = {
        file.name: [error.json_path for error in validator.iter_errors(load_yaml(file).root)]
        for file in bundled_path("fleets").glob("*.yaml")
    }
    assert not any(wrong.values()), wrong


def test_init_prepares_a_folder_and_keeps_its_settings(eal: Program, tmp_path: Path) -> None:
    settings = tmp_path / ".vscode/settings.json"
    settings.parent.mkdir()
    settings.write_text('{"editor.tabSize": 2, "yaml.schemas": {"a.json": "b.yaml"}}')
    assert eal("init", tmp_path).exit_code == 0
    kept = json.loads(settings.read_text())
    assert kept["editor.tabSize"] == 2
    assert kept["yaml.schemas"]["a.json"] == "b.yaml"
    assert "fleets/*.yaml" in kept["yaml.schemas"]["./.vscode/eal/fleet.schema.json"]
    file = tmp_path / "fleets/mine.yaml"
    file.parent.mkdir()
    assert eal("new", "fleet", file, "--robot", "roomba", "--count", "2").exit_code == 0
    first = file.read_text().splitlines()[0]
    assert first == "# yaml-language-server: $schema=../.vscode/eal/fleet.schema.json"
    schema = json.loads((file.parent / first.partition("=")[2]).read_text())
    jsonschema.validate(load_yaml(file).root, schema)
    settings.write_text("{} // mine")
    failed = eal("init", tmp_path)
    assert (failed.exit_code, "remove its comments" in failed.output) == (2, True)
    assert settings.read_text() == "{} // mine"


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("settings.json", '{"yaml.schemas": null}', "'yaml.schemas' must be a mapping"),
        ("extensions.json", '{"recommendations": "a.b"}', "'recommendations' must be a list"),
    ],
)
def test_init_refuses_settings_that_it_cannot_extend(
    eal: Program, tmp_path: Path, name: str, content: str, problem: str
) -> None:
    file = tmp_path / ".vscode" / name
    file.parent.mkdir()
    file.write_text(content)
    done = eal("init", tmp_path)
    assert (done.exit_code, problem in done.output) == (2, True), done.output
    assert (file.read_text(), list(file.parent.iterdir())) == (content, [file])


def test_a_new_file_elsewhere_has_no_header(eal: Program, tmp_path: Path) -> None:
    assert eal("new", "fleet", tmp_path / "mine.yaml", "--robot", "roomba", "--count", "1").exit_code == 0
    assert "yaml-language-server" not in (tmp_path / "mine.yaml").read_text()


def completed(words: str, folder: Path, fleet: str = "") -> list[str]:
    environment = {**os.environ, "_EAL_COMPLETE": "complete_bash", "COMP_WORDS": words, "EAL_FLEET": fleet}
    environment |= {"COMP_CWORD": str(len(words.split(" ")) - 1), "PYTHONPATH": str(bundled_path("."))}
    command = [sys.executable, "-c", "from eal_actors.__main__ import main; main()"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=60)
    assert not done.stderr, done.stderr
    return done.stdout.split()


@pytest.mark.slow
def test_shells_complete_scenarios_fleets_robots_and_resources(tmp_path: Path, write: Write) -> None:
    write("dancers.yaml", "version: 1\n")
    assert completed("eal run dan", tmp_path) == ["dance", "dancers.yaml"]
    assert completed("eal run dance --fleet si", tmp_path) == ["sim"]
    assert completed("eal stop roo", tmp_path, "sim") == ["roomba-1"]
    with Fleet.load("sim") as fleet:
        resources = [name for name in fleet["roomba-1"] if name.startswith("B")]
    assert completed("eal call roomba-1 B", tmp_path, "sim") == resources
    assert completed("eal stop a", tmp_path, "no-such-fleet.yaml") == []
