"""Checks of what moves: it can be stopped at any time, and is usable afterwards."""

from __future__ import annotations

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.conformance.bench import Bench, Findings, actuators, settle
from eal_actors.conformance.values import lasting_argument
from eal_actors.errors import PreemptedError
from eal_actors.resource import Resource


def start_lasting_command(handle: ResourceHandle) -> Future[int] | None:
    """Start the first command that is still under way after its first step; None if there is none.

    Thread: blocks the caller until the resource has begun with it.
    """
    commands = [command for command in handle.info.commands if not command.urgent]
    for command in sorted(commands, key=lambda command: command.argument is None):
        call = lasting_argument(command)
        if call is None:
            continue
        future = handle.send_cmd(*call)
        settle(handle)
        if not future.done():
            return future
    return None


def can_be_halted(bench: Bench, findings: Findings) -> None:
    """Every actuator overrides `halt`, and a halt when nothing moves is harmless, also twice."""
    with bench.robot() as robot:
        for handle in actuators(robot):
            own = type(handle.resource()).halt is not Resource.halt
            findings.expect(holds=own, problem=f"{handle.name} is an actuator and does not override halt")
            findings.answer(handle.halt())
            findings.answer(handle.halt())


def stops_what_runs(bench: Bench, findings: Findings) -> None:
    """While a long command runs, status and halt answer; a halt or newer command ends it, and all works on."""
    with bench.robot() as robot:
        for handle in actuators(robot):
            running = start_lasting_command(handle)
            if running is None:
                continue
            if "get_status" in handle.info.methods:
                findings.answer(handle.get_status())
            findings.expect(holds=not running.done(), problem=f"{running.describe()} ended when asked for the status")
            findings.answer(handle.halt())
            findings.refusal(running, PreemptedError)
            for urgent in sorted(handle.info.urgent_commands):
                running = start_lasting_command(handle)
                _ends_with(findings, handle, running, handle.send_cmd(urgent))
            running = start_lasting_command(handle)
            newer = start_lasting_command(handle)
            _ends_with(findings, handle, running, None)
            findings.answer(handle.halt())
            if newer is not None:
                findings.refusal(newer, PreemptedError)


def _ends_with(
    findings: Findings, handle: ResourceHandle, running: Future[int] | None, stop: Future[int] | None
) -> None:
    again = findings.expect(
        holds=running is not None, problem=f"{handle.name}: a command that lasted did not start again after a halt"
    )
    if stop is not None:
        findings.answer(stop)
    if again and running is not None:
        findings.refusal(running, PreemptedError)
