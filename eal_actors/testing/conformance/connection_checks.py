"""Checks of a plugin's connection to its device: unplugging, concurrent use, release."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, NotReadyError, UnavailableError
from eal_actors.testing.conformance.bench import Bench, BenchRobot, Findings, wait_until

_DESCRIPTORS: Final = Path("/proc/self/fd")
_ROUNDS: Final = 5
_POLL_S: Final = 0.1
_POLLS: Final = 20


def waits_for_its_device(bench: Bench, findings: Findings) -> None:
    """Connected without its device, it starts, reports that it is not ready, and works once the device is there."""
    with bench.emulated_device() as device:
        if device is None:
            return
        device.wire.unplug()
        with bench.connected([device], ready=False) as (target,):
            reports = bool(target.robot.not_ready)
            findings.expect(reports, "its device is absent, but no resource reports that it is not ready")
            device.wire.plug_in()
            _check_recovery(bench, target, findings)


def survives_unplugging(bench: Bench, findings: Findings) -> None:
    """After unplugging, calls fail with NotReadyError at once and halts succeed; plugged in again, everything works."""
    with bench.emulated_device() as device:
        if device is None:
            return
        with bench.connected([device]) as (target,):
            device.wire.unplug()
            gone = wait_until(lambda: bool(target.robot.not_ready), bench.ready_within_s)
            if findings.expect(gone, "its device was unplugged, but no resource reports that it is not ready"):
                for name in target.resources.keys() & target.robot.not_ready.keys():
                    unknown = target.resources[name].get_config("eal-conformance-unknown")  # refused anyway
                    findings.refusal(unknown, NotReadyError)
                for handle in target.resources.values():
                    findings.answer(handle.halt())
            device.wire.plug_in()
            _check_recovery(bench, target, findings)


def _check_recovery(bench: Bench, target: BenchRobot, findings: Findings) -> None:
    ready = wait_until(lambda: not target.robot.not_ready and not _find_unready(target), bench.ready_within_s)
    unready = (*target.robot.not_ready.items(), *_find_unready(target))
    reasons = "; ".join(f"{name}: {reason}" for name, reason in unready)
    findings.expect(ready, f"its device is back, but it does not work again: {reasons}")


def _find_unready(target: BenchRobot) -> list[tuple[str, str]]:
    """Return the resources whose value is not available, with the reason."""
    values = [(name, handle.get_value()) for name, handle in _with_value(target)]
    return [(name, str(error)) for name, value in values if isinstance(error := value.exception(), UnavailableError)]


def _with_value(target: BenchRobot) -> list[tuple[str, ResourceHandle]]:
    return [(name, handle) for name, handle in target.resources.items() if "get_value" in handle.info.methods]


def separates_concurrent_calls(bench: Bench, findings: Findings) -> None:
    """Concurrent calls from several threads all answer, and their bytes on the wire never interleave."""
    with bench.emulated_device() as device, bench.connected([device]) as (target,):
        with ThreadPoolExecutor(max(2 * len(target.resources), 1)) as threads:
            asked = [threads.submit(_ask_everything, handle) for handle in target.resources.values() for _ in range(2)]
            answers = [answer for future in asked for answer in future.result()]
        for answer in answers:
            if not isinstance(answer.exception(), UnavailableError):  # a source may run dry after so many calls
                findings.answer(answer)
        for complaint in device.complaints() if device is not None else ():
            findings.expect(False, f"the emulator received invalid input: {complaint}")


def _ask_everything(handle: ResourceHandle) -> list[Future[Any]]:
    """Read everything, and set each writable key to its present value."""
    info, answers = handle.info, list[Future[Any]]()
    for _ in range(_ROUNDS):
        if "get_value" in info.methods:
            answers.append(handle.get_value())
        if "get_status" in info.methods:
            answers.append(handle.get_status())
        answers += [handle.send_req(request.name) for request in info.requests if request.argument is None]
        for key in info.configs:
            present = handle.get_config(key.name)
            answers.append(present)
            if key.writable and (data := _get_or_none(present)) is not None:
                answers.append(handle.set_config(key.name, data))
        for answer in answers:
            answer.exception()
    return answers


def _get_or_none(future: Future[EALData]) -> EALData | None:
    try:
        return future.get()
    except EALError:
        return None


def releases_its_ports(bench: Bench, findings: Findings) -> None:
    """After closing, none of its files, ports and sockets is open."""
    if not _DESCRIPTORS.is_dir():
        return
    with bench.emulated_device() as device:
        with bench.connected([device]):
            pass  # a first use may open files for good, such as libraries
        before = _open_files()
        with bench.connected([device]) as (target,):  # fails if a port was not released before
            for _, handle in _with_value(target):
                handle.get_value().exception()
        left = _opened_since(before)
        findings.expect(not left, f"is still open after close: {', '.join(sorted(left.values()))}")


def _opened_since(before: dict[str, str]) -> dict[str, str]:
    """Return the files opened since; the emulator closes its end of a wire a moment after the plugin."""
    for _ in range(_POLLS):
        left = {number: file for number, file in _open_files().items() if before.get(number) != file}
        if not left:
            break
        REAL_TIME.sleep(_POLL_S)
    return left


def _open_files() -> dict[str, str]:
    """Return the open files of this process, by descriptor."""
    found = {}
    for entry in os.listdir(_DESCRIPTORS):  # noqa: PTH208  # Path.iterdir would fail for descriptors that close meanwhile
        try:
            found[entry] = os.readlink(_DESCRIPTORS / entry)  # noqa: PTH115
        except OSError:
            continue  # the descriptor of the listing itself
    return found
