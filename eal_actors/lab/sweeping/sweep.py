"""All runs of a sweep: every combination of the parameters' values with every seed."""

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
class Job:
    """One run of a sweep.

    Attributes:
        name: of its folder; the same values and the same seed have the same name in every sweep.
        varied: the values of the parameters that are varied, by name.
        parameters: the values of all parameters, by name.
        seed: where all randomness starts from.
    """

    name: str
    varied: Mapping[str, Any]
    parameters: Mapping[str, Any]
    seed: int

    @property
    def label(self) -> str:
        """Its values and its seed, for people."""
        return " ".join([*(f"{name}={_text(value)}" for name, value in self.varied.items()), f"seed={self.seed}"])


@dataclass(frozen=True, slots=True)
class Sweep:
    """What is to be run.

    Attributes:
        scenario: the scenario, with the values of the parameters that stay the same.
        fleet: the fleet as its file says.
        keep: plugins that move nothing real, and run as they are.
        variations: what is varied.
        seeds: where each combination starts from, one run for each.
    """

    scenario: Scenario
    fleet: FleetConfig
    keep: tuple[str, ...]
    variations: tuple[Variation, ...]
    seeds: tuple[int, ...]

    @property
    def count(self) -> int:
        """How many runs there are."""
        return math.prod(len(variation.values) for variation in self.variations) * len(self.seeds)

    def jobs(self) -> Iterator[Job]:
        """Yield all runs: the last parameter changes fastest, and seeds faster still.

        Raises:
            ConfigError: a parameter may not have a value.
        """
        names = [variation.name for variation in self.variations]
        for values in itertools.product(*(variation.values for variation in self.variations)):
            varied = dict(zip(names, values, strict=True))
            parameters = with_parameters(self.scenario, varied).parameters
            for seed in self.seeds:
                yield Job(_name(parameters, seed), varied, parameters, seed)

    @property
    def scenario_hash(self) -> str:
        """What the scenario says, in short."""
        return scenario_hash(self.scenario)

    @property
    def fleet_hash(self) -> str:
        """What the fleet, its world and this release say, in short."""
        return fleet_hash(self.fleet, self.keep)


def fleet_hash(fleet: FleetConfig, keep: Iterable[str]) -> str:
    """Return the SHA-256 of what decides about runs on a fleet but for the seed, in hexadecimal."""
    world = fleet.world.model_dump_json() if fleet.world is not None else ""
    folders = [str(Path(folder).resolve()) for folder in fleet.plugin_dirs]
    said = {key: value for key, value in fleet.content.items() if key not in ("clock", "seed")}
    text = json.dumps([__version__, sorted(keep), world, folders, said], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _name(parameters: Mapping[str, Any], seed: int) -> str:
    """Return a name that people can read and that no other run has."""
    digest = hashlib.sha256(json.dumps([sorted(parameters.items()), seed], default=str).encode()).hexdigest()[:8]
    shown = ",".join(f"{name}={_text(value)}" for name, value in parameters.items())
    shown = re.sub(r"[^A-Za-z0-9=.,_+-]", "_", shown)[:_LONGEST_NAME]
    return "-".join(part for part in (shown, f"seed={seed}", digest) if part)


def _text(value: object) -> str:
    return (
        json.dumps(list(value))
        if isinstance(value, tuple)
        else f"{value:g}"
        if isinstance(value, float)
        else str(value)
    )
