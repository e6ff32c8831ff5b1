"""Runs of a sweep: every combination of the parameters' values with every seed."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eal_actors import __version__
from eal_actors.lab.sweeping.variations import Variation
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario import Scenario
from eal_actors.scenario.language.parameters import with_parameters
from eal_actors.scenario.language.scenario import scenario_hash

_LONGEST_NAME: Final = 80


@dataclass(frozen=True, slots=True)
class SweepJob:
    """One run of a sweep; the same values and seed have the same folder name in every sweep."""

    name: str
    varied: Mapping[str, Any]
    parameters: Mapping[str, Any]
    seed: int

    @property
    def label(self) -> str:
        """Its varied values and its seed, as text."""
        return " ".join(
            [*(f"{name}={format_value(value)}" for name, value in self.varied.items()), f"seed={self.seed}"]
        )


@dataclass(frozen=True, slots=True)
class Sweep:
    """A parameter sweep. Plugins to keep move nothing real. Each combination runs once with each seed."""

    scenario: Scenario
    fleet: FleetConfig
    keep: tuple[str, ...]
    variations: tuple[Variation, ...]
    seeds: tuple[int, ...]

    @property
    def count(self) -> int:
        """Number of runs."""
        return math.prod(len(variation.values) for variation in self.variations) * len(self.seeds)

    def jobs(self) -> Iterator[SweepJob]:
        """Yield all runs; seeds change fastest, then the last parameter; raise ConfigError if a value is not valid."""
        names = [variation.name for variation in self.variations]
        for values in itertools.product(*(variation.values for variation in self.variations)):
            varied = dict(zip(names, values, strict=True))
            parameters = with_parameters(self.scenario, varied).parameters
            for seed in self.seeds:
                yield SweepJob(_run_name(parameters, seed), varied, parameters, seed)

    @property
    def scenario_hash(self) -> str:
        """Hash of the scenario."""
        return scenario_hash(self.scenario)

    @property
    def fleet_hash(self) -> str:
        """Hash of the fleet, its world and this release."""
        return fleet_hash(self.fleet, self.keep)


def fleet_hash(fleet: FleetConfig, keep: Iterable[str]) -> str:
    """Return the SHA-256, in hexadecimal, of everything but the seed that runs on a fleet depend on."""
    world = fleet.world.model_dump_json() if fleet.world is not None else ""
    folders = [str(Path(folder).resolve()) for folder in fleet.plugin_dirs]
    content = {key: value for key, value in fleet.content.items() if key not in ("clock", "seed")}
    beside = [hashlib.sha256(part).hexdigest() for part in _parts_beside(fleet)]
    text = json.dumps([__version__, sorted(keep), world, folders, content, beside], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _parts_beside(fleet: FleetConfig) -> Iterator[bytes]:
    """Yield the content of the modules of Python steps beside the fleet file, and of its map."""
    for name in dict.fromkeys(step.partition(":")[0] for step in fleet.python_steps):
        if (file := fleet.source.parent / f"{name}.py").is_file():
            yield file.read_bytes()
    if fleet.map_path is not None:
        from eal_actors.device.navigation.map_file import load_map  # numpy, which only fleets with a map need

        yield fleet.map_path.read_bytes()
        yield load_map(fleet.map_path).cells.tobytes()


def _run_name(parameters: Mapping[str, Any], seed: int) -> str:
    """Return a readable and unique name of a run."""
    digest = hashlib.sha256(json.dumps([sorted(parameters.items()), seed], default=str).encode()).hexdigest()[:8]
    readable = ",".join(f"{name}={format_value(value)}" for name, value in parameters.items())
    readable = re.sub(r"[^A-Za-z0-9=.,_+-]", "_", readable)[:_LONGEST_NAME]
    return "-".join(part for part in (readable, f"seed={seed}", digest) if part)


def format_value(value: object) -> str:
    """Return a parameter's value for people and names of folders."""
    if isinstance(value, tuple):
        return json.dumps(list(value))
    return f"{value:g}" if isinstance(value, float) else str(value)
