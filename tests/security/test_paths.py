"""No name leads out of its folder: robots, resources, plugins, keys, scenarios, saved files, pages and images."""

from __future__ import annotations

import http.client
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from eal_actors.cli.plugin import write_plugin
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, ScenarioError
from eal_actors.lab.calibration.step import fit_umbmark
from eal_actors.lab.changes.step import compare_views
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.managers.manifest import ManifestFile
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.operate.dashboard import Dashboard
from eal_actors.scenario import check_scenario, run_scenario
from evbotos.definitions import load_definitions
from evbotos.lock import LockedWheel
from tests.operate.dashboard.rig import open_dashboard, page_of

HOSTILE = ("../x", "..", ".", "a/../../x", "/etc/x", "a/b", "a\\b", "x\0y", "x\n", "", "~/x", "%2e%2e%2fx", "-x")
"""Names that are invalid or lead out of the folder as a part of a path."""
ELSEWHERE = ("../x.csv", "a/../../x.csv", "/etc/eal-x.csv", "../../x.csv")
"""Paths outside the folder that they are relative to."""


def fleet(**changes: Any) -> Mapping[str, Any]:
    return {"version": 1, "name": "f", "robots": {"r": {"plugins": {"sample": {}}}}} | changes


FLEET_NAMES = {
    "fleet": lambda name: fleet(name=name),
    "robot": lambda name: fleet(robots={name: {"plugins": {"sample": {}}}}),
    "type": lambda name: fleet(types={name: {"plugins": {"sample": {}}}}),
    "instance": lambda name: fleet(robots={"r": {"plugins": {name: {"plugin": "sample"}}}}),
    "controller": lambda name: fleet(network={"security": {"controller": name}}),
    "router": lambda name: fleet(network={"security": {"roles": {"routers": [name]}}}),
    "role": lambda name: fleet(network={"security": {"roles": {"observers": [name]}}}),
}


@pytest.mark.parametrize("kind", FLEET_NAMES)
def test_names_of_a_fleet_file(kind: str) -> None:
    EALConfigManager.of(FLEET_NAMES["robot"]("fine"))

    for name in HOSTILE:
        with pytest.raises(ConfigError):
            EALConfigManager.of(FLEET_NAMES[kind](name))


@pytest.mark.parametrize("name", HOSTILE)
def test_names_of_plugins_are_looked_up_and_not_opened(name: str) -> None:
    robot = EALConfigManager.of(fleet(robots={"r": {"plugins": {"one": {"plugin": name or " "}}}})).robot("r")

    problems, broken = EALPluginManager().check(robot)

    assert [problem.message.partition(";")[0] for problem in problems] == [f"unknown plugin {name or ' '!r}"]
    assert not broken


@pytest.mark.parametrize("name", HOSTILE)
def test_names_of_plugins_and_of_their_resources(name: str, tmp_path: Path) -> None:
    good = {"version": 1, "name": "good", "description": "It is.", "plugin_version": "1", "resources": ["Wheels"]}
    ManifestFile.model_validate(good)

    for wrong in ({"name": name}, {"resources": [name]}):
        with pytest.raises(ValidationError):
            ManifestFile.model_validate(good | wrong)
    with pytest.raises((ConfigError, ValueError)):
        write_plugin(name, tmp_path / "plugins")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", HOSTILE)
def test_names_of_certificates(name: str, tmp_path: Path) -> None:
    make_authority(tmp_path / "keys", "f")
    before = sorted(tmp_path.rglob("*"))

    with pytest.raises(ConfigError):
        make_certificate(tmp_path / "keys", name, force=True)

    assert sorted(tmp_path.rglob("*")) == before


# Scenarios.

SCENARIO = """\
version: 1
name: {name}
parameters: {{where: {{type: string, default: here}}}}
roles: {{all: {{}}}}
steps:
  - on: all
    do:
      - get_value: {{resource: SampleResource}}
        save: {save}
"""


def written(file: Path, *, name: str = "s", save: str = "x.csv") -> Path:
    file.write_text(SCENARIO.format(name=repr(name), save=repr(save)))
    return file


@pytest.mark.parametrize("name", HOSTILE)
def test_names_of_scenarios_which_their_runs_are_named_after(name: str, tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    assert not check_scenario(written(file))
    file.write_text(SCENARIO.format(name=f'"{name.encode("unicode_escape").decode()}"', save="x.csv"))

    assert check_scenario(file)


@pytest.mark.parametrize("path", ELSEWHERE)
@pytest.mark.parametrize("way", ["as it is written", "as a parameter says"])
def test_paths_to_save_at_that_are_known_before_anything_moves(path: str, way: str, tmp_path: Path) -> None:
    """Parameters from the dashboard or the command line cannot select a path outside the run."""
    is_parameter = way == "as a parameter says"
    file = written(tmp_path / "s.yaml", save="${where}.csv" if is_parameter else path)
    given = {"where": path.removesuffix(".csv")} if is_parameter else {}

    with Fleet.load("local") as opened, pytest.raises(ConfigError, match="not a file name inside the run's folder"):
        run_scenario(file, opened, parameters=given, directory=tmp_path / "run")

    assert [found.name for found in tmp_path.iterdir()] == ["s.yaml"]


@pytest.mark.parametrize("path", ELSEWHERE)
def test_paths_to_save_at_that_come_out_on_the_way(path: str, tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    steps = f"      - let: {{place: \"'{path.removesuffix('.csv')}'\"}}\n      - get_value"
    file.write_text(written(file, save="${place}.csv").read_text().replace("      - get_value", steps))

    with Fleet.load("local") as opened:
        report = run_scenario(file, opened, directory=tmp_path / "run")

    assert report.outcome == "failed"
    assert "not a file name inside the run's folder" in str(report)
    assert {found.name for found in tmp_path.iterdir()} == {"s.yaml", "run"}
    assert list(tmp_path.rglob("*.csv")) == []


class Context:
    """A run, as the Python steps see it."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.robot = "r"
        self.robots: dict[str, Any] = {"r": None}
        self.log = print


@pytest.mark.parametrize("path", ELSEWHERE)
def test_names_that_python_steps_are_given(path: str, tmp_path: Path) -> None:
    context: Any = Context(tmp_path / "run")
    names = {"before": "a.png", "after": "b.png", "save": "c.png"}
    for argument in names:
        with pytest.raises(ScenarioError, match="inside the run's folder"):
            compare_views(context, **(names | {argument: path.replace("csv", "png")}))
    with pytest.raises(ScenarioError, match="inside the run's folder"):
        fit_umbmark(context, side_m=4.0, name=path.removesuffix(".csv"), ends=[["cw", 0, 0]], wheelbase_m=0.3)
    assert list(tmp_path.iterdir()) == []


# The dashboard.


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[Dashboard]:
    (tmp_path / "scenarios").mkdir()
    written(tmp_path / "scenarios" / "fine.yaml", save="${where}.csv")
    written(tmp_path / "secret.yaml")
    for folder in (tmp_path, tmp_path / "runs", tmp_path / "runs" / "old"):  # the last is of another dashboard
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "report.html").write_text("a report")
    with (
        Fleet.load("local") as opened,
        open_dashboard(opened, scenarios=tmp_path / "scenarios", runs_dir=tmp_path / "runs") as page,
    ):
        yield page


def test_the_dashboard_serves_nothing_but_its_own_files(dashboard: Dashboard) -> None:
    for path in (
        "/static/../app.py",
        "/static/../../../../../../etc/passwd",
        "/static/%2e%2e/%2e%2e/app.py",
        "/static/..%2f..%2fapp.py",
        "/static//etc/passwd",
        "/../../etc/passwd",
        "/static/%00",
        "/runs/",
        "/runs/../report.html",
        "/runs/..%2f/report.html",
        "/runs/%2e%2e/report.html",
        "/runs/old/report.html",
    ):
        with closing(http.client.HTTPConnection("127.0.0.1", dashboard.port, timeout=20)) as connection:
            connection.request("GET", path)

            assert connection.getresponse().status == 404, path


def test_the_dashboard_starts_no_scenario_but_those_of_its_folder(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        for file in ("../secret.yaml", "../secret", "/etc/passwd", "..", "", "fine.yaml/../../secret.yaml", "dance"):
            assert "error" in page.ask(do="start", file=file, parameters={}), file


def test_the_dashboards_users_save_nothing_outside_their_run(dashboard: Dashboard, tmp_path: Path) -> None:
    with page_of(dashboard) as page:
        answer = page.ask(do="start", file="fine.yaml", parameters={"where": "../../../x"})

    assert "not a file name inside the run's folder" in str(answer)
    assert list(tmp_path.rglob("x.csv")) == []


# EvBotOS.


def test_names_of_boards_and_images_are_looked_up_and_not_opened() -> None:
    definitions = load_definitions()

    for name in HOSTILE:
        for find in (definitions.platform, definitions.image):
            with pytest.raises(ConfigError, match="there is no"):
                find(name)


@pytest.mark.parametrize("name", HOSTILE)
def test_names_of_locked_files(name: str) -> None:
    LockedWheel(name="n", version="1", file="n-1-py3-none-any.whl", sha256="0" * 64)

    for file in (name, f"{name}.whl", f"x.whl/{name}"):
        with pytest.raises(ValidationError):
            LockedWheel(name="n", version="1", file=file, sha256="0" * 64)
