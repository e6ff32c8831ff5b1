"""How a run ends for its robots, and what its variables are then."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from eal_actors.scenario.engine.cast import RobotRun
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.records import is_recordable, told
from eal_actors.scenario.report import RobotReport


def end_robots(stage: Stage, unfinished: Collection[str]) -> None:
    """Give every robot that still takes part its outcome; call it when the steps are over.

    Args:
        stage: the run.
        unfinished: the roles that had something left to do.
    """
    cut_short = {seat.robot.name for role in unfinished for seat in stage.seats.get(role, ())}
    for robot in stage.robots.values():
        if robot.outcome is None:
            is_cut = stage.is_stopping and robot.name in cut_short
            robot.end("spare" if not robot.is_seated else "aborted" if is_cut else "done")


def variables_of_run(stage: Stage) -> dict[str, Any]:
    """Return the main scenario's variables, without its parameters and without what does not go into a record."""
    parameters = stage.plan.scenario.parameters
    return _told({name: value for name, value in stage.main.variables.items() if name not in parameters})


def report_robot(stage: Stage, robot: RobotRun) -> RobotReport:
    """Return how a robot fared, with the variables of its place."""
    report = robot.report()
    for seats in stage.seats.values():
        for seat in seats:
            if seat.robot is robot:
                report.variables.update(_told(seat.variables))
    return report


def _told(variables: dict[str, object]) -> dict[str, Any]:
    return {name: told(value) for name, value in variables.items() if is_recordable(value)}
