"""Checks of actuators: they can be stopped at any time, and work afterwards."""

from __future__ import annotations

from typing import Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.info import CommandInfo
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import PreemptedError, ResourceFaultError, ReturnTypeError
from eal_actors.testing.conformance.bench import Bench, Findings, actuators, wait_until, wait_until_started
from eal_actors.testing.conformance.values import lasting_argument

_REST_S: Final = 5.0
"""Real seconds in which a halted resource comes to rest, and a reading shows it."""


def start_command(handle: ResourceHandle, command: CommandInfo, findings: Findings) -> Future[int] | None:
    """Start a command with a valid argument; return None if no argument can be chosen.

    A command that fails by itself is a problem; a model that allows less than its type is not. Raises BlockedActor if
    the command blocks the resource's actor.

    Thread: blocks the caller until the resource has started the command.
    """
    call = lasting_argument(command)
    if call is None:
        return None
    future = handle.send_cmd(*call)
    what = f"{handle.name}: send_cmd {call[0]}"
    wait_until_started(handle, what)
    if future.done() and isinstance(error := future.exception(), ResourceFaultError | ReturnTypeError):
        findings.expect(False, f"{what} failed: {error.code}: {error.message}")
    return future


def start_lasting_command(handle: ResourceHandle, findings: Findings) -> Future[int] | None:
    """Start the first command that still runs after its first step; return None if there is none.

    Raises BlockedActor if a command blocks the resource's actor.

    Thread: blocks the caller until the resource has started the command.
    """
    commands = [command for command in handle.info.commands if not command.urgent]
    for command in sorted(commands, key=lambda command: command.argument is None):
        future = start_command(handle, command, findings)
        if future is not None and not future.done():
            return future
    return None


def runs_commands(bench: Bench, findings: Findings) -> None:
    """Every command starts with a valid argument, without failing or blocking its actor."""
    with bench.robot() as robot:
        for handle in robot.values():
            for command in handle.info.commands:
                future = start_command(handle, command, findings)
                if future is not None:
                    findings.tried += 1
                    if not future.done():
                        findings.answer(handle.halt())


def can_be_halted(bench: Bench, findings: Findings) -> None:
    """Every actuator overrides `halt`, and a halt without motion is harmless, also twice."""
    with bench.robot() as robot:
        for handle in actuators(robot):
            own = type(handle.resource()).halt is not Resource.halt
            findings.expect(own, f"{handle.name} is an actuator and does not override halt")
            findings.answer(handle.halt())
            findings.answer(handle.halt())


def stops_running_commands(bench: Bench, findings: Findings) -> None:
    """During a long command, status and halt answer; a halt or newer command ends it, and the resource still works."""
    with bench.robot() as robot:
        for handle in actuators(robot):
            running = start_lasting_command(handle, findings)
            if running is None:
                continue
            if "get_status" in handle.info.methods:
                findings.answer(handle.get_status())
            findings.expect(not running.done(), f"a request for the status ended {running.describe()}")
            findings.answer(handle.halt())
            findings.refusal(running, PreemptedError)
            for urgent in sorted(handle.info.urgent_commands):
                running = start_lasting_command(handle, findings)
                _expect_preempted(findings, handle, running, handle.send_cmd(urgent))
            running = start_lasting_command(handle, findings)
            newer = start_lasting_command(handle, findings)
            _expect_preempted(findings, handle, running, None)
            findings.answer(handle.halt())
            if newer is not None:
                findings.refusal(newer, PreemptedError)


def comes_to_rest(bench: Bench, findings: Findings) -> None:
    """The status of a resource with a stop command is 0 at rest: before its first command, and soon after a halt."""
    with bench.robot() as robot:
        for handle in robot.values():
            if handle.info.urgent_commands and "get_status" in handle.info.methods:
                _expect_rest(findings, handle)


def _expect_rest(findings: Findings, handle: ResourceHandle) -> None:
    status = findings.answer(handle.get_status())
    is_known = findings.expect(not status, f"{handle.name}: its status is {status} before its first command, not 0")
    if is_known and start_lasting_command(handle, findings) is not None:
        findings.answer(handle.halt())
        rests = wait_until(lambda: not findings.answer(handle.get_status()), _REST_S)
        findings.expect(rests, f"{handle.name}: its status is not 0 after a halt")


def _expect_preempted(
    findings: Findings, handle: ResourceHandle, running: Future[int] | None, stop: Future[int] | None
) -> None:
    again = findings.expect(running is not None, f"{handle.name}: a long command did not start again after a halt")
    if stop is not None:
        findings.answer(stop)
    if again and running is not None:
        findings.refusal(running, PreemptedError)
