"""Factory of a test's simulations, which closes them at the end."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.testing.making import Robots, World
from eal_actors.testing.simulation import Simulation

_GRACE_S: Final = 2.0
"""Real seconds that threads have to end after their simulation is closed."""


class SimulationFactory:
    """The value of the fixture `simulation`: a callable with the arguments of `Simulation` that returns an open one.

    Args:
        seed: seed of simulations without one; None leaves their default.
    """

    def __init__(self, seed: int | None = None) -> None:
        self._seed = seed
        self._made: list[Simulation] = []

    def __call__(
        self,
        robots: Robots,
        world: World | None = None,
        *,
        seed: int | None = None,
        plugin_dirs: Sequence[str | Path] = (),
    ) -> Simulation:
        """Return a new connected simulation; arguments and errors as for `Simulation` and its `open`."""
        chosen = self._seed if seed is None else seed
        simulation = Simulation(robots, world, seed=chosen, plugin_dirs=plugin_dirs)
        self._made.append(simulation)
        return simulation.open()

    def describe(self) -> str:
        """Return a line for each simulation, with the seed that repeats a failed test."""
        return "\n".join(f"{made!r}, {made.now_s:g} s since the start, --eal-seed={made.seed}" for made in self._made)

    def close(self) -> tuple[str, ...]:
        """Close every simulation; return the names of threads that still run. Thread: blocks the caller."""
        for simulation in self._made:
            simulation.close()
        end_s = REAL_TIME.now() + _GRACE_S
        left = [simulation.threads_left(max(0.0, end_s - REAL_TIME.now())) for simulation in self._made]
        return tuple(name for names in left for name in names)
