"""Checks of what moves: it can be stopped at any time, and is usable afterwards."""

from __future__ import annotations

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.info import CommandInfo
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import PreemptedError, ResourceFaultError, ReturnTypeError
from eal_actors.testing.conformance.bench import Bench, Findings, actuators, settle
from eal_actors.testing.conformance.values import lasting_argument


def start_command(handle: ResourceHandle, command: CommandInfo, findings: Findings) -> Future[int] | None:
    """Start a command with an argument that is allowed; None if none can be made up.

    Notes a problem if the command has failed by itself; that a make allows less than its kind is no problem.

    Raises:
        BlockedActor: it does not let go of the resource's thread.

    Thread: blocks the caller until the resource has begun with it.
    """
    call = lasting_argument(command)
    if call is None:
        return None
    future = handle.send_cmd(*call)
    what = f"{handle.name}: send_cmd {call[0]}"
    settle(handle, what)
    if future.done() and isinstance(error := future.exception(), ResourceFaultError | ReturnTypeError):
        findings.expect(holds=False, problem=f"{what} failed: {error.code}: {error.message}")
    return future


def start_lasting_command(handle: ResourceHandle, findings: Findings) -> Future[int] | None:
    """Start the first command that is still under way after its first step; None if there is none.

    Raises:
        BlockedActor: see start_command.

    Thread: see start_command.
    """
    commands = [command for command in handle.info.commands if not command.urgent]
    for command in sorted(commands, key=lambda command: command.argument is None):
        future = start_command(handle, command, findings)
        if future is not None and not future.done():
            return future
    return None


def carries_out_commands(bench: Bench, findings: Findings) -> None:
    """Every command begins with an argument that is allowed, without failing or blocking its actor."""
    with bench.robot() as robot:
        for handle in robot.values():
            for command in handle.info.commands:
                future = start_command(handle, command, findings)
                if future is not None:
                    findings.tried += 1
                    if not future.done():
                        findings.answer(handle.halt())


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
            running = start_lasting_command(handle, findings)
            if running is None:
                continue
            if "get_status" in handle.info.methods:
                findings.answer(handle.get_status())
            findings.expect(holds=not running.done(), problem=f"{running.describe()} ended when asked for the status")
            findings.answer(handle.halt())
            findings.refusal(running, PreemptedError)
            for urgent in sorted(handle.info.urgent_commands):
                running = start_lasting_command(handle, findings)
                _ends_with(findings, handle, running, handle.send_cmd(urgent))
            running = start_lasting_command(handle, findings)
            newer = start_lasting_command(handle, findings)
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
