"""How things stand after a step of the top level: written down, and put in place again."""

from __future__ import annotations

from functools import partial

from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.engine.cast import RobotRun, Seat
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.events import Checkpoint, RobotReplaced
from eal_actors.scenario.model import final_action
from eal_actors.scenario.records import from_record, is_recordable, to_record
from eal_actors.scenario.report import ErrorReport
from eal_actors.scenario.resuming import Resumption


def seat_robots(stage: Stage) -> None:
    """Give the robots of each role their places; spares take those of robots that did not start."""
    plan = stage.plan
    for role, names in plan.roles.items():
        section = plan.scenario.file.roles[role]
        has_spares = final_action(section.on_failure or plan.scenario.file.on_failure) == "substitute"
        chosen: list[RobotRun] = []
        for name in names:
            if name not in plan.lost:
                chosen.append(stage.robots[name])
            elif has_spares and (spare := stage.take_spare(role)) is not None:
                chosen.append(spare)
                stage.substitutes.setdefault(name, (spare.name, role))
            for robot in chosen[-1:]:
                robot.is_seated = True
        stage.seats[role] = [Seat(role, index, len(chosen), robot) for index, robot in enumerate(chosen)]


def tell_lost(stage: Stage) -> None:
    """Tell which robots take no part from the start, and who takes their place."""
    for name, error in stage.plan.lost.items():
        robot = stage.robots[name]
        if robot.outcome is not None:  # told before the run was cut off
            continue
        robot.is_seated = True
        if name in stage.substitutes:
            robot.end("replaced", error)
            by, role = stage.substitutes[name]
            stage.tell(partial(_replaced, name, by, role, ErrorReport.of(error)))
        else:
            stage.drop(robot, error)


def _replaced(robot: str, by: str, role: str, error: ErrorReport, time_s: float) -> RobotReplaced:
    return RobotReplaced(time_s, robot, by, role, error)


def checkpoint(stage: Stage, next_step: int, time_s: float) -> Checkpoint:
    """Return how things stand."""
    unsaved: set[str] = set()

    def kept(variables: dict[str, object]) -> dict[str, object]:
        unsaved.update(name for name, value in variables.items() if not is_recordable(value))
        return {name: to_record(value) for name, value in variables.items() if is_recordable(value)}

    seats = {
        role: tuple({"robot": seat.robot.name, "variables": kept(seat.variables)} for seat in seats)
        for role, seats in stage.seats.items()
    }
    own = {name: value for name, value in stage.main.variables.items() if name not in stage.plan.scenario.parameters}
    signals = {
        name: {"count": count, "value": to_record(stage.signals.values[unit, name])}
        for (unit, name), count in stage.signals.counts.items()
        if unit is stage.main
    }
    return Checkpoint(time_s, next_step, kept(own), seats, signals, tuple(sorted(unsaved)))


def restore(stage: Stage, resumption: Resumption) -> None:
    """Put everything back as it stood at the last checkpoint; robots that were gone stay away.

    Raises:
        ScenarioError: a robot that is needed is not there.
    """
    for role, places in resumption.seats.items():
        seats = []
        for index, place in enumerate(places):
            robot = stage.robots.get(place["robot"])
            if robot is None:
                raise ScenarioError(f"robot '{place['robot']}' of role '{role}' takes no part any more")
            robot.is_seated = True
            variables = {name: from_record(value) for name, value in place["variables"].items()}
            seats.append(Seat(role, index, len(places), robot, variables))
        stage.seats[role] = seats
    stage.main.variables.update({name: from_record(value) for name, value in resumption.variables.items()})
    for name, signal in resumption.signals.items():
        stage.signals.counts[stage.main, name] = signal["count"]
        stage.signals.values[stage.main, name] = from_record(signal["value"])
    for name, (outcome, report) in resumption.gone.items():
        if name in stage.robots:
            stage.robots[name].is_seated = True
            error = ScenarioError(report.message)
            stage.robots[name].end("replaced" if outcome == "replaced" else "dropped", error)
    stage.records.extend(resumption.records)
    stage.starts.extend(resumption.starts)
