"""The state of a run in records: slots at the start, checkpoints, resumption, outcomes, and the report."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

from eal_actors.kernel.clock import ScaledClock
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.lock_step import LockStepClock
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.frames import Participant, RoleSlot
from eal_actors.scenario.language.scenario import scenario_hash
from eal_actors.scenario.language.values import final_action
from eal_actors.scenario.report.events import Checkpoint, RobotReplaced, RunContinued, RunStarted
from eal_actors.scenario.report.records import from_record, is_recordable, to_record, to_view
from eal_actors.scenario.report.resuming import Resumption
from eal_actors.scenario.report.summary import ContactReport, ErrorReport, Report, RobotOutcome, RobotReport, RunOutcome


def fill_slots(run: RunContext) -> None:
    """Put the robots of each role into slots; spares replace those that did not start."""
    plan = run.plan
    for role, names in plan.roles.items():
        section = plan.scenario.file.roles[role]
        has_spares = final_action(section.on_failure or plan.scenario.file.on_failure) == "substitute"
        chosen: list[Participant] = []
        for name in names:
            if name not in plan.lost:
                chosen.append(run.robots[name])
            elif has_spares and (spare := run.take_spare(role)) is not None:
                chosen.append(spare)
                run.substitutes.setdefault(name, (spare.name, role))
            for robot in chosen[-1:]:
                robot.has_taken_part = True
        run.slots[role] = [RoleSlot(role, index, len(chosen), robot) for index, robot in enumerate(chosen)]


def report_lost(run: RunContext) -> None:
    """Record the robots that did not start, and the spares in their slots."""
    for name, error in run.plan.lost.items():
        robot = run.robots[name]
        if robot.outcome is not None:  # recorded before the interruption
            continue
        robot.has_taken_part = True
        if name in run.substitutes:
            robot.end("replaced", error)
            by, role = run.substitutes[name]
            run.emit(partial(RobotReplaced, robot=name, by=by, role=role, error=ErrorReport.of(error)))
        else:
            run.drop(robot, error)


def make_checkpoint(run: RunContext, next_step: int, time_s: float) -> Checkpoint:
    """Return the state of the run before a step of the top level."""
    unsaved: set[str] = set()

    def recordable(variables: dict[str, object]) -> dict[str, object]:
        unsaved.update(name for name, value in variables.items() if not is_recordable(value))
        return {name: to_record(value) for name, value in variables.items() if is_recordable(value)}

    seats = {
        role: tuple({"robot": slot.robot.name, "variables": recordable(slot.variables)} for slot in slots)
        for role, slots in run.slots.items()
    }
    own = {name: value for name, value in run.main.variables.items() if name not in run.plan.scenario.parameters}
    signals = {
        name: {"count": count, "value": to_record(run.signals.values[frame, name])}
        for (frame, name), count in run.signals.counts.items()
        if frame is run.main
    }
    return Checkpoint(time_s, next_step, recordable(own), seats, signals, tuple(sorted(unsaved)))


def restore(run: RunContext, resumption: Resumption) -> None:
    """Restore the last checkpoint; robots that had left stay away. Raise ScenarioError if another one is missing."""
    for role, seats in resumption.slots.items():
        slots = []
        for index, seat in enumerate(seats):
            name = seat["robot"]
            if name in run.substitutes and name not in resumption.gone:  # it did not start this time
                name = run.substitutes[name][0]
            robot = run.robots.get(name)
            if robot is None:
                raise ScenarioError(f"robot '{name}' of role '{role}' is not part of the run")
            robot.has_taken_part = True
            variables = {name: from_record(value) for name, value in seat["variables"].items()}
            slots.append(RoleSlot(role, index, len(seats), robot, variables))
        run.slots[role] = slots
    run.main.variables.update({name: from_record(value) for name, value in resumption.variables.items()})
    for name, signal in resumption.signals.items():
        run.signals.counts[run.main, name] = signal["count"]
        run.signals.values[run.main, name] = from_record(signal["value"])
    for name, (outcome, report) in resumption.gone.items():
        if name in run.robots:
            run.robots[name].has_taken_part = True
            run.robots[name].end("replaced" if outcome == "replaced" else "dropped", ScenarioError(report.message))
    run.records.extend(resumption.records)
    run.starts.extend(resumption.starts)


# Outcomes.


def end_robots(run: RunContext, next_step: int) -> None:
    """Set the outcome of every robot that still takes part; `next_step` is the first top-level step not over."""
    scenario, steps = run.plan.scenario, run.plan.scenario.file.steps
    roles: Iterable[str] = scenario.roles_at_work(steps, ("steps",), next_step)
    if any(step.needs_everyone() for step in steps[next_step:]):
        roles = scenario.file.roles
    cut_short = {slot.robot.name for role in roles for slot in run.slots.get(role, ())}
    for robot in run.robots.values():
        if robot.outcome is None:
            is_cut = run.is_stopping and robot.name in cut_short
            took_part: RobotOutcome = "failed" if robot.error is not None else "aborted" if is_cut else "done"
            robot.end(took_part if robot.has_taken_part else "spare")


def variables_of_run(run: RunContext) -> dict[str, Any]:
    """Return the main scenario's variables, without its parameters and values that have no form in a record."""
    parameters = run.plan.scenario.parameters
    return _views({name: value for name, value in run.main.variables.items() if name not in parameters})


def report_robot(run: RunContext, robot: Participant) -> RobotReport:
    """Return the outcome of a robot, with the variables of its slots."""
    variables: dict[str, Any] = {}
    for slots in run.slots.values():
        for slot in slots:
            if slot.robot is robot:
                variables |= _views(slot.variables)
    error = ErrorReport.of(robot.error) if robot.error is not None else None
    return RobotReport(outcome=robot.outcome or "aborted", error=error, variables=variables, losses=tuple(robot.losses))


def _views(variables: dict[str, object]) -> dict[str, Any]:
    return {name: to_view(value) for name, value in variables.items() if is_recordable(value)}


# The first event and the report.


def run_started(run: RunContext, time_s: float) -> RunStarted:
    """Return the first event of a run."""
    plan = run.plan
    return RunStarted(
        time_s,
        **_inputs(run),
        scenario_hash=scenario_hash(plan.scenario),
        roles=plan.roles,
        spares=plan.spares,
        robots=plan.robots,
        calls=plan.calls,
    )


def run_continued(run: RunContext, first_step: int, wall_continued: str, time_s: float) -> RunContinued:
    """Return the first event of a resumed run."""
    plan = run.plan
    name, fleet = plan.scenario.name, run.fleet.config.name
    return RunContinued(time_s, first_step, wall_continued, name, fleet, plan.robots, plan.calls)


def make_report(
    run: RunContext,
    before: Resumption | None,
    wall_started: str,
    duration_s: float,
    outcome: tuple[RunOutcome, BaseException | None],
) -> Report:
    """Return the report of a run that is over, and that may continue an interrupted one."""
    return Report(
        **_inputs(run),
        roles={role: list(names) for role, names in run.plan.roles.items()},
        wall_started=wall_started,
        duration_s=duration_s,
        paused_s=run.pauses.paused_s,
        continued_s=(*before.continued_s, before.time_s) if before is not None else (),
        outcome=outcome[0],
        error=ErrorReport.of(outcome[1]) if outcome[1] is not None else None,
        robots={name: report_robot(run, robot) for name, robot in run.robots.items()},
        variables=variables_of_run(run),
        steps=tuple(run.records),
        starts=tuple(run.starts),
        contacts=tuple(
            ContactReport(time_s=contact.time_s - run.zero_s, robot=contact.robot, other=contact.other)
            for contact in run.fleet.services.contacts.copy()
            if contact.time_s >= run.zero_s
        ),
    )


def _inputs(run: RunContext) -> dict[str, Any]:
    """Return the fields of a run's inputs, which its first event and its report have."""
    scenario, config, clock = run.plan.scenario, run.fleet.config, run.fleet.clock
    return {
        "scenario": scenario.name,
        "scenario_file": str(scenario.source),
        "fleet": config.name,
        "fleet_file": str(config.source),
        "seed": config.seed,
        "rate": clock.rate if isinstance(clock, ScaledClock | LockStepClock) else config.rate,
        "parameters": {name: to_record(value) for name, value in scenario.parameters.items()},
    }
