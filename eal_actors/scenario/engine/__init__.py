"""Carries out a plan: one thread however many robots there are, a generator for each line of steps."""

from eal_actors.scenario.engine.blocking import run_scenario
from eal_actors.scenario.engine.run import Run
from eal_actors.scenario.journal import Listener

__all__ = ["Listener", "Run", "run_scenario"]
