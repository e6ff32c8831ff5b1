"""Checks of a plugin's life cycle: reconnection, clean-up, and independence of its instances."""

from __future__ import annotations

import logging
import threading

from eal_actors.actors.handles import ResourceHandle
from eal_actors.kernel.errors import PluginError
from eal_actors.testing.conformance.bench import Bench, Findings, Resources
from eal_actors.testing.conformance.motion_checks import start_lasting_command
from eal_actors.testing.conformance.values import other_value


def reconnects(bench: Bench, findings: Findings) -> None:
    """It can be disconnected and connected again, with the same resources."""
    with bench.robot() as robot:
        before = list(robot)
    with bench.robot() as robot:
        findings.expect(list(robot) == before, f"there were {before}, and then {list(robot)}")


def leaves_no_thread(bench: Bench, findings: Findings) -> None:
    """After closing the robot during a command, no thread is left."""
    before = set(threading.enumerate())
    with bench.robot() as robot:
        for handle in robot.values():
            start_lasting_command(handle, findings)
    left = sorted(thread.name for thread in set(threading.enumerate()) - before)
    findings.expect(not left, f"threads are left behind: {', '.join(left)}")


def cleans_up(bench: Bench, findings: Findings) -> None:
    """Closed during a command, nothing raises: no `finally`, `halt`, `close`, `destroy_X` or `disconnect`."""
    errors = _Errors()
    logger = logging.getLogger("eal_actors")
    logger.addHandler(errors)
    try:
        leaves_no_thread(bench, Findings())
    finally:
        logger.removeHandler(errors)
    findings.tried += 1
    findings.problems += errors.lines


class _Errors(logging.Handler):
    """Collects the errors of the log."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        fields = record.__dict__.get("eal", {})
        words = [str(fields[key]) for key in ("resource", "step", "error", "reason") if key in fields]
        self.lines.append(": ".join(words) or record.getMessage())


def shares_no_state(bench: Bench, findings: Findings) -> None:
    """Two robots with the plugin do not disturb each other."""
    try:
        with bench.robots(2) as (first, second):
            for name in first:
                _check_independence(findings, first, second, name)
    except PluginError:
        with bench.robot():  # a single one starts, so the second one finds the hardware in use
            return


def _check_independence(findings: Findings, first: Resources, second: Resources, name: str) -> None:
    one, other = first[name], second[name]
    findings.expect(one.resource() is not other.resource(), f"{name}: both robots have the same object")
    running = start_lasting_command(one, findings)
    if running is not None:
        findings.answer(other.halt())
        findings.expect(not running.done(), f"{name}: halting one robot stopped the other")
        findings.answer(one.halt())
    for key in one.info.configs:
        if key.writable:
            _check_key(findings, one, other, key.name)
    if {"get_value", "set_value"} <= one.info.methods and one.info.value is not None:
        present = findings.answer(other.get_value())
        value = other_value(one.info.value, present) if present is not None else None
        if value is not None and findings.answer(one.set_value(value)) is not None:
            seen = findings.answer(other.get_value())
            apart = seen is None or seen.value != value
            findings.expect(apart, f"{name}: setting one robot's value set the other's")


def _check_key(findings: Findings, one: ResourceHandle, other: ResourceHandle, key: str) -> None:
    before, kept = findings.answer(other.get_config(key)), findings.answer(one.get_config(key))
    if before is None or kept is None:
        return
    value = other_value(one.info.config(key).value, before)
    if value is None or one.set_config(key, value).exception() is not None:  # a model may allow less than the type
        return
    after = findings.answer(other.get_config(key))
    same = after is not None and after.payload == before.payload
    findings.expect(same, f"{one.name}: setting {key} of one robot changed the other's")
    findings.answer(one.set_config(key, kept))
