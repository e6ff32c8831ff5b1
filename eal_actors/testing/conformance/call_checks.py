"""Checks of calls that must answer and of calls that must be refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import METHODS, ValueInfo
from eal_actors.kernel.errors import ArgumentError, UnavailableError, UnsupportedError
from eal_actors.testing.conformance.bench import Bench, Findings, wait_until_started
from eal_actors.testing.conformance.motion_checks import start_lasting_command
from eal_actors.testing.conformance.values import bad_commands, bad_values

_UNKNOWN: Final = "eal-conformance-unknown"  # a name that no command, request or configuration key has

_CONNECTIONS: Final = 3  # a busy machine may be late once, but a driver that does not wait is late each time
_READINGS: Final = ("get_value", "get_status")
_ANY_CALL: Final[dict[str, Callable[[ResourceHandle], Future[Any]]]] = {
    "get_status": lambda handle: handle.get_status(),
    "get_value": lambda handle: handle.get_value(),
    "set_value": lambda handle: handle.set_value(0),
    "send_req": lambda handle: handle.send_req(_UNKNOWN),
    "send_cmd": lambda handle: handle.send_cmd(_UNKNOWN),
    "read_comm": lambda handle: handle.read_comm(1),
    "write_comm": lambda handle: handle.write_comm("x"),
    "get_config": lambda handle: handle.get_config(_UNKNOWN),
    "set_config": lambda handle: handle.set_config(_UNKNOWN, 0),
}


def reports_unsupported_methods(bench: Bench, findings: Findings) -> None:
    """A method that a resource lacks raises UnsupportedError, which names resource and method."""
    with bench.robot() as robot:
        for name, handle in robot.items():
            for method in METHODS:
                read_only = method == "set_config" and handle.info.configs  # each key refuses by itself
                if method in handle.info.methods or read_only:
                    continue
                error = findings.refusal(_ANY_CALL[method](handle), UnsupportedError)
                if error is not None:
                    names = name in str(error) and method in str(error)
                    findings.expect(names, f"{name}: {method}: the error does not name both: {error}")


def answers_at_once(bench: Bench, findings: Findings) -> None:
    """The first call of each resource answers right after opening, as with `eal call`, which waits for nothing else."""
    for _ in range(_CONNECTIONS):
        problems = _make_first_calls(bench, findings)
        if not problems:
            return
    findings.problems += problems


def _make_first_calls(bench: Bench, findings: Findings) -> list[str]:
    """Connect, call each resource once, and return the problems."""
    with bench.emulated_device() as device, bench.connected([device], ready=False) as (target,):
        calls = []
        for handle in target.resources.values():
            calls += [_ANY_CALL[method](handle) for method in _READINGS if method in handle.info.methods][:1]
        findings.tried += len(calls)
        return [
            f"{call.describe().partition('/')[2]} failed: {error.message}; wait for the first answer in `connect`"
            for call in calls
            if isinstance(error := call.exception(), UnavailableError)
        ]


def answers(bench: Bench, findings: Findings) -> None:
    """Status, value, configuration and requests without argument answer in time, with the declared type and unit."""
    with bench.robot() as robot:
        for name, handle in robot.items():
            info = handle.info
            if "get_status" in info.methods:
                findings.answer(handle.get_status())
            if "get_value" in info.methods:
                _check_answer(findings, f"{name}: get_value", handle.get_value(), info.value)
            for key in info.configs:
                _check_answer(findings, f"{name}: get_config {key.name}", handle.get_config(key.name), key.value)
            for request in info.requests:
                if request.argument is None:
                    what = f"{name}: send_req {request.name}"
                    _check_answer(findings, what, handle.send_req(request.name), request.returns)


def _check_answer(findings: Findings, what: str, future: Future[EALData], promised: ValueInfo | None) -> None:
    data = findings.answer(future)
    if data is None or promised is None:
        return
    problem = promised.problem(data)
    findings.expect(problem is None, f"{what}: the answer {problem}")
    same_unit = data.unit is None or data.unit == promised.unit
    findings.expect(same_unit, f"{what}: the answer is in {data.unit}, declared is {promised.unit}")


def keeps_configuration(bench: Bench, findings: Findings) -> None:
    """A writable configuration key accepts its own value, and returns it again."""
    with bench.robot() as robot:
        for name, handle in robot.items():
            for key in handle.info.configs:
                before = findings.answer(handle.get_config(key.name)) if key.writable else None
                if before is None or findings.answer(handle.set_config(key.name, before)) is None:
                    continue
                after = findings.answer(handle.get_config(key.name))
                same = after is not None and (after.type, after.payload) == (before.type, before.payload)
                findings.expect(same, f"{name}: {key.name} was {before!r}; set to this value, it is {after!r}")


def refuses_unknown_names(bench: Bench, findings: Findings) -> None:
    """Unknown commands, requests and configuration keys raise ArgumentError."""
    with bench.robot() as robot:
        for handle in robot.values():
            info = handle.info
            if info.commands and not any(command.prefix == "" for command in info.commands):
                findings.refusal(handle.send_cmd(_UNKNOWN), ArgumentError)
            if info.requests and not any(request.prefix == "" for request in info.requests):
                findings.refusal(handle.send_req(_UNKNOWN), ArgumentError)
            if info.configs:
                findings.refusal(handle.get_config(_UNKNOWN), ArgumentError)
                findings.refusal(handle.set_config(_UNKNOWN, 0), ArgumentError)


def refuses_bad_arguments(bench: Bench, findings: Findings) -> None:
    """Arguments of the wrong type or outside their range raise ArgumentError, and change nothing."""
    with bench.robot() as robot:
        for name, handle in robot.items():
            _refuse_commands(findings, handle)
            _refuse_requests(findings, handle)
            for key in handle.info.configs:
                before = findings.answer(handle.get_config(key.name))
                for value in bad_values(key.value):
                    findings.refusal(handle.set_config(key.name, value), ArgumentError)
                after = findings.answer(handle.get_config(key.name))
                if before is not None and after is not None:
                    same = before.payload == after.payload
                    findings.expect(same, f"{name}: {key.name}: a refused value changed it to {after!r}")
            if handle.info.value is not None and "set_value" in handle.info.methods:
                for value in bad_values(handle.info.value):
                    findings.refusal(handle.set_value(value), ArgumentError)


def _refuse_commands(findings: Findings, handle: ResourceHandle) -> None:
    """Send bad commands to an idle resource, then during a running command, which they must not disturb."""
    info = handle.info
    calls = [
        (text, data)
        for command in info.commands
        if not (command.urgent and command.argument is None)  # a stop with an extra argument may stop
        for text, data in bad_commands(command)
    ]
    asks_status = "get_status" in info.methods
    before = findings.answer(handle.get_status()) if asks_status else None
    for text, data in calls:
        findings.refusal(handle.send_cmd(text, data), ArgumentError)
    if calls and asks_status:
        after = findings.answer(handle.get_status())
        findings.expect(before == after, f"{handle.name}: refused commands changed its status: {before} to {after}")
    running = start_lasting_command(handle, findings) if calls else None
    if running is not None:
        findings.refusal(handle.send_cmd(*calls[0]), ArgumentError)
        wait_until_started(handle, running.describe())
        findings.expect(not running.done(), f"a refused command stopped {running.describe()}")
        findings.answer(handle.halt())


def _refuse_requests(findings: Findings, handle: ResourceHandle) -> None:
    for request in handle.info.requests:
        if request.prefix is not None:
            for text, data in bad_commands(request):
                if data is None:
                    findings.refusal(handle.send_req(text), ArgumentError)
