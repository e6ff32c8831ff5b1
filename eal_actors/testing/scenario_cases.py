"""Scenario files as pytest test cases: `pytest --eal scenarios/`."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import ConfigError, EALError
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Report, Scenario, StepRecord, load_scenario, run_scenario
from eal_actors.scenario.language.binding import bound_robots
from eal_actors.scenario.language.loading import find_fleet_beside, is_scenario_file
from eal_actors.scenario.language.parameters import read_settings, with_parameters

_SECTION: Final = "eal_actors run"


def collect_scenario(path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Return a collector for a scenario file; None for any other YAML file, such as a fleet."""
    if not is_scenario_file(path):
        return None
    return ScenarioCaseFile.from_parent(parent, path=path)


def check_settings(config: pytest.Config, items: Iterable[pytest.Item]) -> None:
    """Raise UsageError for a value of --eal-set that belongs to no parameter of a collected scenario."""
    known = {name for item in items if isinstance(item, ScenarioCase) for name in item.scenario.file.parameters}
    for name, _ in config.getoption("--eal-set"):
        if name not in known:
            hint = did_you_mean(name, known)
            raise pytest.UsageError(f"--eal-set: no collected scenario has a parameter '{name}'{hint}")


class ScenarioCaseFile(pytest.File):
    """A scenario file: one test case, if it has an `expect` or is selected explicitly."""

    def collect(self) -> Iterator[pytest.Item]:
        """Yield the test case."""
        try:
            scenario = load_scenario(self.path)
        except ConfigError as error:
            raise self.CollectError(str(error)) from error
        if self.config.getoption("--eal-all") or self.session.isinitpath(self.path) or scenario.expectations():
            yield ScenarioCase.from_parent(self, name=scenario.name, scenario=scenario)


class _CaseFailed(Exception):  # noqa: N818  # pytest calls it a failure
    """A run is not done, or an expectation failed."""

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__("\n".join(lines))


class ScenarioCase(pytest.Item):
    """One run of a scenario in simulation, as fast as possible."""

    def __init__(self, *, scenario: Scenario, **keywords: Any) -> None:
        super().__init__(**keywords)
        self.scenario = scenario

    def runtest(self) -> None:
        """Run the scenario.

        Raises:
            EALError: the run could not start.
            _CaseFailed: the run is not done, or an expectation failed.
        """
        given: Path | None = self.config.getoption("--eal-fleet")
        fleet = find_fleet_beside(self.path) if given is None else self.config.invocation_params.dir / given
        config = EALConfigManager.load(fleet).fleet
        seed = self.config.getoption("--eal-seed")
        config = replace(config, seed=config.seed if seed is None else seed)
        self.user_properties += [("eal_fleet", str(short_path(fleet))), ("eal_seed", config.seed)]
        # Beside the folders of `tmp_path`, which pytest keeps for its last three runs; pytest's own items do the same.
        factory: pytest.TempPathFactory = self.config._tmp_path_factory  # type: ignore[attr-defined]  # noqa: SLF001
        directory = factory.mktemp(re.sub(r"\W", "_", self.name)[:30], numbered=True)
        report = self._run(config, directory)
        if report.outcome == "done" and not any(map(self._is_broken, report.steps)):
            shutil.rmtree(directory)
            return
        lines = [
            self._failure_line(step)
            for step in report.steps
            if self._is_broken(step) or step.outcome in ("failed", "dropped")
        ]
        if not lines and report.error is not None:
            lines.append(report.error.message)
        self.user_properties.append(("eal_run", str(directory)))
        lines.append(f"the run: {report.outcome} after {report.duration_s:.2f} s of the fleet's clock")
        raise _CaseFailed([*lines, f"run folder: {directory}"])

    def _run(self, config: FleetConfig, directory: Path) -> Report:
        given = [f"{name}={value}" for name, value in self.config.getoption("--eal-set")]
        own = [text for text in given if text.partition("=")[0] in self.scenario.file.parameters]
        scenario = with_parameters(self.scenario, read_settings(self.scenario.file, own))
        robots = bound_robots(scenario, config)
        twins = simulated(config, robots, self.config.getoption("--eal-keep"))
        changes = [f"{name}: {why}" for name, why in twins.replaced.items()]
        changes += [f"{name}: left out: {why}" for name, why in twins.left_out.items()]
        if changes:
            self.add_report_section("call", _SECTION, "\n".join(changes))
        with Fleet(twins.config).connect(robots) as opened:
            for problem in opened.problems:
                raise problem
            return run_scenario(scenario, opened, directory=directory)

    def _is_broken(self, step: StepRecord) -> bool:
        """Return whether a step is an expectation that did not hold, even if the scenario continued."""
        return step.step in self.scenario.expectations() and step.outcome not in ("done", "aborted", "stopped")

    def _failure_line(self, step: StepRecord) -> str:
        place = self.scenario.position_of(step.step)
        who = f" ({step.robot})" if step.robot is not None else ""
        why = step.error.message if step.error is not None else step.outcome
        what = "" if step.step in self.scenario.expectations() else f"{step.label} {step.outcome}: "
        return f"{short_path(Path(place.file))}:{place.line}:{place.column}: {step.step}{who}: {what}{why}"

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], *arguments: Any) -> Any:
        """Return the failure, without a traceback if the scenario caused it."""
        if not isinstance(excinfo.value, _CaseFailed | EALError):
            return super().repr_failure(excinfo, *arguments)
        facts = dict(self.user_properties)
        lines = [str(excinfo.value)]
        if "eal_seed" in facts:
            lines.append(f"fleet {facts['eal_fleet']}, --eal-seed={facts['eal_seed']}")
        return "\n".join(lines)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return the file, the line and the name."""
        return self.path, 0, f"scenario {self.name}"
