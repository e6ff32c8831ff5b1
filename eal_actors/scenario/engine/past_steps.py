"""The steps of an interrupted block that were over: a resumed run performs the block again, and leaves them out.

The control flow of a scenario depends on its variables, on readings of robots and on the outcomes of steps. The record
has all three, so the second pass takes the same way, up to the steps that were under way. Those are performed again,
which is refused unless it does no harm: a command must never be carried out twice.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from eal_actors.device.info import ResourceInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.scenario.engine.plan import Plan
from eal_actors.scenario.language.expressions.grammar import RobotReading
from eal_actors.scenario.language.scenario import Step
from eal_actors.scenario.language.values import final_action
from eal_actors.scenario.report.records import from_record
from eal_actors.scenario.report.resuming import Resumption

_Key = tuple[str | None, str]
"""A robot, None outside of `on`, and the path of a step."""
_REPLAYED: Final = ("done", "skipped", "dropped")
_PLACE: Final = ".visit"
"""The end of the paths of drives to the places of a `visit`."""


@dataclass(frozen=True, slots=True)
class PastStep:
    """A step that was over. `variables` are those that it assigned."""

    is_done: bool
    variables: Mapping[str, Any]


@dataclass
class PastSteps:
    """The entries of the record about a block that was interrupted, in their order.

    Attributes:
        ended: the steps that were over.
        readings: the values that were read for conditions, loops and variables.
        begun: how often each robot had begun each step.
    """

    ended: dict[_Key, deque[PastStep]] = field(default_factory=dict)
    readings: dict[_Key, deque[Mapping[str, Any]]] = field(default_factory=dict)
    under_way: dict[_Key, Mapping[str, Any]] = field(default_factory=dict)
    begun: Counter[_Key] = field(default_factory=Counter)

    @classmethod
    def of(cls, resumption: Resumption, plan: Plan, fleet: Fleet) -> PastSteps:
        """Read the record since its last checkpoint.

        Raises ScenarioError if a step that was under way must not be repeated, or the record is not enough to continue.
        """
        past, reader = cls(), _RecordJudge(resumption, plan, fleet)
        for event in resumption.since:
            match event["event"]:
                case "step_started":
                    key = event["robot"], event["step"]
                    past.begun[key] += key not in past.under_way  # or an earlier resumption repeats it
                    past.under_way[key] = event
                case "step_ended":
                    record = event["record"]
                    key = record["robot"], record["step"]
                    past.under_way.pop(key, None)
                    reader.check_outcome(record)
                    if event.get("unsaved"):  # the value must be read again
                        reader.check_repeatable(record)
                        continue
                    values = {name: from_record(value) for name, value in event.get("variables", {}).items()}
                    past.ended.setdefault(key, deque()).append(PastStep(record["outcome"] == "done", values))
                case "readings":
                    past.readings.setdefault((event["robot"], event["step"]), deque()).append(event["values"])
                case "robot_replaced":
                    raise reader.error(f"{event['by']} had replaced {event['robot']} in")
        for event in past.under_way.values():
            reader.check_repeatable(event)
        reader.check_started()
        return past

    def take(self, robot: str | None, path: str) -> PastStep | None:
        """Return the next pass of a step if it was over, else None."""
        ended = self.ended.get((robot, path))
        return ended.popleft() if ended else None

    def take_readings(self, robot: str | None, path: str, wanted: Iterable[RobotReading]) -> dict[RobotReading, object]:
        """Return the values that were read; none if they were not read, or are not in the record."""
        values = self.readings.get((robot, path))
        if not values:
            return {}
        found = values.popleft()
        return {reading: from_record(found[str(reading)]) for reading in wanted if str(reading) in found}

    def had_met(self, path: str, robot: str, others: Collection[str]) -> bool:
        """Return whether a robot was in a step with `together` to which all others had come too."""
        count = self.begun[robot, path]
        return (robot, path) in self.under_way and all(self.begun[other, path] >= count for other in others)


class _RecordJudge:
    """Judges the entries of a record."""

    def __init__(self, resumption: Resumption, plan: Plan, fleet: Fleet) -> None:
        self._resumption = resumption
        self._plan = plan
        self._fleet = fleet
        self._steps: dict[str, Step] = {name: step for *_, name, step in plan.scenario.walk()}

    def error(self, what: str) -> ScenarioError:
        """Return the error that the run cannot continue."""
        directory, first = self._resumption.directory, f"steps[{self._resumption.first_step}]"
        place = self._plan.scenario.position_of(first)
        return ScenarioError(
            f"the run in {directory} cannot be resumed: {what} {first} ({place.file}:{place.line}). "
            "`safe_to_repeat: true` there repeats the whole step"
        )

    def check_started(self) -> None:
        """Refuse a spare in place of a robot that did not start again: what it had done is not the spare's."""
        file, gone = self._plan.scenario.file, self._resumption.gone
        for role, seats in self._resumption.slots.items():
            policy = file.roles[role].on_failure or file.on_failure
            for robot in (seat["robot"] for seat in seats):
                if robot in self._plan.lost and robot not in gone and final_action(policy) == "substitute":
                    raise self.error(f"{robot} did not start, and no spare can go on inside")

    def check_outcome(self, record: Mapping[str, Any]) -> None:
        """Refuse a record whose way through the scenario cannot be taken again."""
        step = self._step(record["step"])
        if record["outcome"] not in _REPLAYED or (record["outcome"] != "done" and (step is None or step.children())):
            raise self.error(f"{record['label']} ({record['step']}) was {record['outcome']} in")

    def check_repeatable(self, entry: Mapping[str, Any]) -> None:
        """Refuse a step that must not be performed again."""
        step, robot = self._step(entry["step"]), entry["robot"]
        info = self._info(robot, entry.get("resource"))
        if step is None or not step.may_repeat(self._plan.python, info, entry.get("command")):
            who = "" if robot is None else f"{robot}: "
            mark = self._plan.scenario.position_of(entry["step"])
            where = f"{entry['step']}, {mark.file}:{mark.line}"
            raise self.error(f"{who}{entry['label']} ({where}) was under way, and is not safe to repeat, in")

    def _step(self, path: str) -> Step | None:
        return self._steps.get(path.removesuffix(_PLACE))

    def _info(self, robot: str | None, resource: str | None) -> ResourceInfo | None:
        if robot is None or resource is None:
            return None
        try:
            return self._fleet[robot][resource].info
        except EALError:
            return None
