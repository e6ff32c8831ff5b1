"""The checks of a soak's history: pure functions from the history to violations."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Final

from tests.soak.history import RELAYS, Command, Fault, History, merged, overlap_s, touches

WARDEN: Final = "warden#1"
"""The process of a controller that lives from the beginning to the end."""
SLACK_S: Final = 1.0
"""How long a process may wait for a processor on a busy machine, between what it decides and what it writes down."""
LATE_S: Final = 0.25
"""How long a process may wait for a processor before that counts as hunger; tests/net/test_deadlines.py allows none."""
CATCH_SHARE: Final = 0.2
"""Of the freezes, how many may strike between a command's admission and its first line."""


def twice(history: History) -> Iterator[str]:
    """No command runs twice, not even in another process of the robot."""
    for robot, notes in history.notes.items():
        for number, times in Counter(note.number for note in notes if note.event in ("begin", "mark")).items():
            if times > 1:
                yield f"{robot}: command {number} ran {times} times"


def late(history: History) -> Iterator[str]:
    """No command begins after its deadline.

    A freeze may strike between the check and the first line of a command: of one command a freeze, and rarely.
    """
    caught: list[str] = []
    freezes = 0
    for robot, notes in history.notes.items():
        frozen = history.spans(robot, "freeze")
        freezes += len(frozen)
        thaws = {next((note.number for note in notes if note.time_s >= end_s), None) for _, end_s in frozen}
        hungry = merged(history.hungry.get(robot, ()))
        for note in notes:
            if note.event not in ("begin", "mark"):
                continue
            command = history.commands[note.number]
            deadline_s = command.sent_s + command.timeout_s
            after = deadline_s, note.time_s
            if note.time_s - deadline_s <= LATE_S:  # nearly all; the waits are long to add up
                continue
            late_s = note.time_s - deadline_s - overlap_s(after, hungry) - history.waited_s(robot, after)
            if late_s > LATE_S:
                what = f"{robot}: command {note.number} began {late_s:.2f} s after its deadline"
                is_caught = note.number in thaws and touches((command.sent_s, note.time_s), frozen)
                if is_caught:
                    caught.append(what)
                else:
                    yield what
    if len(caught) > max(1, CATCH_SHARE * freezes):
        yield from caught


def overrun(history: History) -> Iterator[str]:
    """No motion lasts past the deadline of its command; a robot that was frozen stops it when it wakes."""
    for robot in history.notes:
        pauses = history.pauses(robot)
        for motion in history.motions(robot):
            command = history.commands[motion.number]
            deadline_s = command.sent_s + command.timeout_s
            after = deadline_s, motion.rest_s
            if motion.rest_s - deadline_s <= LATE_S:
                continue
            over_s = motion.rest_s - deadline_s - overlap_s(after, pauses) - history.waited_s(robot, after)
            if over_s > LATE_S:
                yield f"{robot}: command {motion.number} moved for {over_s:.2f} s after its deadline"


def unwatched(history: History) -> Iterator[str]:
    """No robot moves for longer than twice the dead-man's time after it could hear its controller the last time."""
    for robot in history.notes:
        frozen = history.pauses(robot)
        for motion in history.motions(robot):
            controller = history.commands[motion.number].controller
            for begin_s, end_s in history.silences(controller, robot):
                span = max(begin_s, motion.begin_s), min(end_s, motion.rest_s)
                alone_s = span[1] - span[0] - overlap_s(span, frozen)
                if alone_s > 2 * history.dead_man_s + SLACK_S:
                    yield f"{robot}: command {motion.number} moved for {alone_s:.2f} s without {controller}"


def out_of_order(history: History) -> Iterator[str]:
    """Commands of one controller to one actuator run in the order in which they were sent."""
    for robot, notes in history.notes.items():
        last: dict[tuple[str, str], int] = {}
        for note in notes:
            if note.event in ("begin", "mark"):
                key = history.commands[note.number].controller, note.event
                if note.number < last.get(key, -1):
                    yield f"{robot}: command {note.number} ran after {last[key]}"
                last[key] = note.number


def two_motions(history: History) -> Iterator[str]:
    """A robot's wheels do one thing at a time."""
    for robot in history.notes:
        motions = history.motions(robot)
        for earlier, later in itertools.pairwise(motions):
            if later.begin_s < earlier.rest_s:
                yield f"{robot}: command {later.number} began before {earlier.number} rested"


def two_masters(history: History) -> Iterator[str]:
    """An actuator passes from one controller to another only if the first was silent, left, or the robot forgot it.

    Silent is also who had no processor to say anything with, or whose words nobody had one to hear with.
    """
    for robot, notes in history.notes.items():
        last: dict[str, tuple[str, float]] = {}
        forgets = history.spans(robot, "kill", "freeze")
        busy = {name: history.pauses(name, robot, RELAYS) for name in history.lives}
        for note in notes:
            if note.event not in ("begin", "mark"):
                continue
            controller = history.commands[note.number].controller
            before, since_s = last.get(note.event, (controller, note.time_s))
            if before != controller:
                reasons = forgets + history.silences(before, robot) + busy[before]
                if not touches((since_s, note.time_s), reasons):
                    yield f"{robot}: command {note.number} of {controller} ran while {before} was there"
            last[note.event] = controller, note.time_s


def untrue(history: History) -> Iterator[str]:
    """A command reported as done was done."""
    done = {note.number for notes in history.notes.values() for note in notes if note.event in ("end", "mark")}
    for command in history.commands.values():
        if command.outcome == "ok" and command.number not in done:
            yield f"{command.robot}: command {command.number} was reported done, but was not"


def untold(history: History) -> Iterator[str]:
    """Every command has its outcome by its deadline, unless the controller was killed."""
    pauses = {name: history.pauses(name) for name in history.lives}
    for command in history.commands.values():
        killed = [begin_s for begin_s, _ in history.spans(command.controller, "kill")]
        frozen = pauses[command.controller]
        until_s = min([*killed, command.done_s])
        if until_s == math.inf:
            yield f"{command.controller}: command {command.number} never had an outcome"
            continue
        waited_s = until_s - command.sent_s - overlap_s((command.sent_s, until_s), frozen)
        if waited_s > command.timeout_s + 2 * SLACK_S and not _is_flood(history, command):
            yield f"{command.controller}: command {command.number} was answered {waited_s:.2f} s after it was sent"
    for life in history.lives.values():
        if life.unsettled:
            yield f"{life.name}: {life.unsettled} calls without an outcome at its end"


def _is_flood(history: History, command: Command) -> bool:
    """Return whether a command was one of hundreds at once, whose outcomes take their time to be written down."""
    return command.number - 50 in history.commands and (
        command.sent_s - history.commands[command.number - 50].sent_s < SLACK_S
    )


def unseen(history: History) -> Iterator[str]:
    """Every fault that lasts is in the record of the controller that is never killed."""
    life = history.lives[WARDEN]
    away = life.leaves + history.pauses(WARDEN)
    for fault in history.faults:
        if fault.target not in history.notes or fault.kind in ("garbage", "slow"):
            continue
        notice_s = 2 * SLACK_S + (history.lease_s if fault.kind in ("stall", "freeze") else 0.0)
        begin_s, end_s = fault.span
        if end_s - begin_s < notice_s or touches((begin_s - 10.0, end_s), away):
            continue
        if not _is_lost_during(life.states, fault, notice_s):
            yield f"{WARDEN}: {fault.kind} of {fault.target} for {end_s - begin_s:.1f} s was not noticed"


def _is_lost_during(states: list[tuple[float, str, str]], fault: Fault, notice_s: float) -> bool:
    before = "lost"
    for time_s, robot, state in states:
        if robot != fault.target:
            continue
        if time_s > fault.begin_s + notice_s:
            break
        before = state
        if time_s >= fault.begin_s and state == "lost":
            return True
    return before == "lost"


def not_back(history: History) -> Iterator[str]:
    """When all faults are over, everybody finds together again."""
    states = history.lives[WARDEN].states
    last = {robot: state for time_s, robot, state in states if time_s <= history.end_s}
    for robot in history.notes:
        if last.get(robot) != "ready":
            yield f"{robot} is {last.get(robot)} for {WARDEN} at the end, not ready"


CHECKS: Final[dict[str, Callable[[History], Iterator[str]]]] = {
    "no command runs twice": twice,
    "no command runs late": late,
    "no motion outlives its deadline": overrun,
    "no robot moves without a live controller": unwatched,
    "commands keep their order": out_of_order,
    "one motion at a time": two_motions,
    "one controller at a time": two_masters,
    "reported commands are done": untrue,
    "every command has its outcome in time": untold,
    "every lasting fault is in the record": unseen,
    "everybody finds together again": not_back,
}
