"""Simulated fleets for tests: a world in one line, time that the test advances, and true poses for assertions.

    with Simulation({"scout": "roomba"}) as simulation:
        simulation["scout"]["Base"].send_cmd("f1")
        simulation.advance(10.0)
        assert simulation.pose("scout").x_m > 0.9

The pytest fixture `simulation` makes simulations, and closes them at the end of the test.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eal_actors.testing.simulation import Pose, Simulation, SimulationFactory

__all__ = ["Pose", "Simulation", "SimulationFactory"]


def __getattr__(name: str) -> Any:
    """Import a public name lazily: pytest imports this package in every run, and most runs do not use it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("eal_actors.testing.simulation"), name)
