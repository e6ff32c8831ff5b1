"""Proofs of scenario files as pytest test cases: `pytest --eal --eal-prove scenarios/`."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import ConfigError, EALError
from eal_actors.lab.proof.proof import Finding, Proof, ProofRequest, prove
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Scenario, load_scenario
from eal_actors.scenario.language.loading import find_fleet_beside, is_scenario_file
from eal_actors.scenario.language.parameters import read_settings, with_parameters


def collect_proof(path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Return a collector for a scenario file; None for any other YAML file, such as a fleet."""
    return ProofCaseFile.from_parent(parent, path=path) if is_scenario_file(path) else None


class ProofCaseFile(pytest.File):
    """A scenario file: one test case."""

    def collect(self) -> Iterator[pytest.Item]:
        """Yield the test case."""
        try:
            scenario = load_scenario(self.path)
        except ConfigError as error:
            raise self.CollectError(str(error)) from error
        yield ProofCase.from_parent(self, name=f"proof of {scenario.name}", scenario=scenario)


class _ProofFailed(Exception):  # noqa: N818  # pytest calls it a failure
    """The proof has findings."""


class ProofCase(pytest.Item):
    """The proof of a scenario."""

    def __init__(self, *, scenario: Scenario, **keywords: Any) -> None:
        super().__init__(**keywords)
        self.scenario = scenario

    def runtest(self) -> None:
        """Prove the scenario.

        Raises:
            EALError: the proof could not start.
            _ProofFailed: there are findings.
        """
        option = self.config.option
        given: Path | None = option.eal_fleet
        fleet = find_fleet_beside(self.path) if given is None else Path(self.config.invocation_params.dir) / given
        config = EALConfigManager.load(fleet).fleet
        config = replace(config, seed=config.seed if option.eal_seed is None else option.eal_seed)
        settings = [f"{name}={value}" for name, value in option.eal_set if name in self.scenario.file.parameters]
        scenario = with_parameters(self.scenario, read_settings(self.scenario.file, settings))
        factory: pytest.TempPathFactory = self.config._tmp_path_factory  # type: ignore[attr-defined]  # noqa: SLF001  # as its own items do
        out = factory.mktemp("proof", numbered=True)
        jobs = os.cpu_count() or 1
        proof = prove(ProofRequest(scenario, config, out, keep=option.eal_keep, runs=option.eal_prove_runs, jobs=jobs))
        self.user_properties.append(("eal_proof", f"{len(proof.cases)} of {proof.planned} single faults and pairs"))
        if proof.is_proven:
            shutil.rmtree(out)
            return
        raise _ProofFailed("\n".join(self._line(proof, finding) for finding in proof.findings))

    def _line(self, proof: Proof, finding: Finding) -> str:
        violation = finding.violation
        step = violation.step or finding.cases[0].case[0].position.step
        place = proof.scenario.position_of(step)
        where = f"{short_path(Path(place.file))}:{place.line}:{place.column}"
        fleet = f"\n    least fleet: {finding.fleet_file}" if finding.fleet_file is not None else ""
        return f"{where}: {finding.invariant}: {violation.message} ({finding.cases[0].label}){fleet}"

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], *arguments: Any) -> Any:
        """Return the failure, without a traceback if the scenario caused it."""
        if isinstance(excinfo.value, _ProofFailed | EALError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, *arguments)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return the file, the line and the name."""
        return self.path, 0, self.name
