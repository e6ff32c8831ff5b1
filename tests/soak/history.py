"""The history of a soak, recorded by robots, controllers and the fault injector.

All times are of the machine's monotonic clock, which its processes share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

Interval = tuple[float, float]
RELAYS: Final = "relays"
"""By which name a history knows the process through which all passes that robots and controllers say."""


@dataclass(frozen=True)
class Fault:
    """Something that was made wrong on purpose.

    Attributes:
        kind: `kill`, `freeze`, `cut`, `stall`, `slow` or `garbage`.
        target: a robot, or a controller.
        begin_s: from when.
        end_s: until when; of a kill, until the next process was started.
    """

    kind: str
    target: str
    begin_s: float
    end_s: float

    @property
    def span(self) -> Interval:
        """When it was."""
        return self.begin_s, self.end_s


@dataclass(frozen=True)
class Note:
    """A line that a robot wrote: `begin`, `end`, `rest` and `halt` of its wheels, `mark` of its pen."""

    time_s: float
    event: str
    number: int


@dataclass
class Command:
    """A command that a controller sent.

    Attributes:
        number: which; no other command has it.
        controller: who sent it.
        robot: to whom.
        resource: `Wheels` or `Pen`.
        sent_s: when, at the latest.
        timeout_s: how long its outcome was waited for.
        outcome: `ok` or an error's code; None without an outcome.
        done_s: the time of the outcome.
    """

    number: int
    controller: str
    robot: str
    resource: str
    sent_s: float
    timeout_s: float
    outcome: str | None = None
    done_s: float = math.inf


@dataclass(frozen=True)
class Motion:
    """Wheels that turn: from the beginning of a command until they rest, or their process was killed."""

    number: int
    begin_s: float
    rest_s: float


@dataclass
class ControllerLife:
    """One process of a controller.

    Attributes:
        name: of the controller.
        states: what it saw of robots: time, robot, state.
        leaves: when it took its leave, and until when that was over.
        unsettled: calls that it still waited for when it should have had all outcomes.
        outcomes: how often readings and halts came to what.
    """

    name: str
    states: list[tuple[float, str, str]] = field(default_factory=list)
    leaves: list[Interval] = field(default_factory=list)
    unsettled: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)


@dataclass
class History:
    """Everything together.

    Attributes:
        end_s: the end of the last fault, when the controllers were stopped.
        dead_man_s: how long a controller may be silent.
        lease_s: after how long a silent link counts as broken.
        faults: what was made wrong.
        notes: what each robot wrote.
        commands: by their numbers.
        lives: of controllers, by the names of their processes.
        hungry: when a robot, a controller's process, or the relays between them had no processor, by their names.
        waits: the shorter times for which one of their threads waited for a processor, each with the look it was in.
    """

    end_s: float
    dead_man_s: float
    lease_s: float
    faults: list[Fault] = field(default_factory=list)
    notes: dict[str, list[Note]] = field(default_factory=dict)
    commands: dict[int, Command] = field(default_factory=dict)
    lives: dict[str, ControllerLife] = field(default_factory=dict)
    hungry: dict[str, list[Interval]] = field(default_factory=dict)
    waits: dict[str, list[tuple[Interval, float]]] = field(default_factory=dict)

    def spans(self, target: str, *kinds: str) -> list[Interval]:
        """Return when something was wrong with a target."""
        return [fault.span for fault in self.faults if fault.target == target and fault.kind in kinds]

    def read_robot(self, robot: str, lines: Iterable[str]) -> None:
        """Apply a line that a robot wrote."""
        words = (line.split() for line in lines)
        self.notes[robot] = [Note(float(time_s), event, int(number)) for time_s, event, number in words]

    def read_controller(self, name: str, lines: Iterable[str]) -> None:
        """Apply the lines of a controller's process; a last line that a kill has cut off is ignored."""
        life = self.lives[name] = ControllerLife(name)
        for line in lines:
            time_text, event, *words = line.split()
            time_s = float(time_text)
            if event == "sent":
                number, robot, resource, timeout_s = words
                self.commands[int(number)] = Command(int(number), name, robot, resource, time_s, float(timeout_s))
            elif event == "done":
                command = self.commands[int(words[0])]
                if command.outcome is not None:
                    raise AssertionError(f"command {command.number} has two outcomes")
                command.outcome, command.done_s = words[1], time_s
            elif event == "state":
                life.states.append((time_s, words[0], words[1]))
            elif event == "leaving":
                life.leaves.append((time_s, math.inf))
            elif event == "left":
                life.leaves[-1] = (life.leaves[-1][0], time_s)
            elif event == "unsettled":
                life.unsettled += int(words[0])
            elif event != "up":
                key = f"{event} {words[-1]}"
                life.outcomes[key] = life.outcomes.get(key, 0) + 1

    def pauses(self, *targets: str) -> list[Interval]:
        """Return when one of the targets did nothing, frozen or for want of a processor; each without a gap."""
        return merged(
            span for target in targets for span in [*self.spans(target, "freeze"), *self.hungry.get(target, ())]
        )

    def waited_s(self, target: str, span: Interval) -> float:
        """Return how long a thread of a target may have waited for a processor, in short waits, within an interval."""
        return sum(min(waited_s, overlap_s(span, [look])) for look, waited_s in self.waits.get(target, ()))

    def motions(self, robot: str) -> list[Motion]:
        """Return what a robot's wheels did; a motion whose process was killed ends there."""
        kills = sorted(begin_s for begin_s, _ in self.spans(robot, "kill"))
        rests = {note.number: note.time_s for note in self.notes[robot] if note.event == "rest"}
        motions = []
        for note in self.notes[robot]:
            if note.event == "begin":
                killed_s = next((kill_s for kill_s in kills if kill_s >= note.time_s), math.inf)
                motions.append(Motion(note.number, note.time_s, rests.get(note.number, killed_s)))
        return motions

    def silences(self, controller: str, robot: str) -> list[Interval]:
        """Return when a robot could not hear a controller's process, each as long as it lasted without a gap."""
        spans = self.spans(robot, "cut", "stall") + self.spans(controller, "freeze")
        spans += [(begin_s, math.inf) for begin_s, _ in self.spans(controller, "kill")]
        spans += self.lives[controller].leaves
        return merged(spans)


def merged(spans: Iterable[Interval]) -> list[Interval]:
    """Return intervals that do not touch, sorted."""
    result: list[Interval] = []
    for begin_s, end_s in sorted(spans):
        if result and begin_s <= result[-1][1]:
            result[-1] = (result[-1][0], max(result[-1][1], end_s))
        else:
            result.append((begin_s, end_s))
    return result


def overlap_s(span: Interval, others: Iterable[Interval]) -> float:
    """Return for how long an interval overlaps with others, which do not overlap with each other."""
    return sum(max(0.0, min(span[1], end_s) - max(span[0], begin_s)) for begin_s, end_s in others)


def touches(span: Interval, others: Iterable[Interval]) -> bool:
    """Return whether an interval touches another one."""
    return any(begin_s <= span[1] and span[0] <= end_s for begin_s, end_s in others)
