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
from eal_actors.testing.conformance.bench import Bench, BenchRobot, Findings, comes_true

_DESCRIPTORS: Final = Path("/proc/self/fd")
_ROUNDS: Final = 5
_LOOK_S: Final = 0.1
_LOOKS: Final = 20


def waits_for_its_device(bench: Bench, findings: Findings) -> None:
    """Connected without its device, it starts, reports that it is not ready, and works once the device is there."""
    with bench.stand_in() as stand_in:
        if stand_in is None:
            return
        stand_in.unplug()
        with bench.connected([stand_in], ready=False) as (place,):
            findings.expect(
                holds=bool(place.robot.not_ready),
                problem="its device is absent, but no resource reports that it is not ready",
            )
            stand_in.plug_in()
            _check_recovery(bench, place, findings)


def bears_unplugging(bench: Bench, findings: Findings) -> None:
    """After unplugging, calls fail with NotReadyError at once; after plugging in again, everything works."""
    with bench.stand_in() as stand_in:
        if stand_in is None:
            return
        with bench.connected([stand_in]) as (place,):
            stand_in.unplug()
            gone = comes_true(lambda: bool(place.robot.not_ready), bench.ready_within_s)
            if findings.expect(
                holds=gone, problem="its device was unplugged, but no resource reports that it is not ready"
            ):
                for name in place.robot.not_ready:
                    findings.refusal(_probe(place.resources[name]), NotReadyError)
                for handle in place.resources.values():
                    _refuses_or_answers(handle.halt(), findings)
            stand_in.plug_in()
            _check_recovery(bench, place, findings)


def _probe(handle: ResourceHandle) -> Future[Any]:
    """Make a call that every resource refuses, with NotReadyError if its device is absent."""
    return handle.get_config("eal-conformance-nobody")


def _refuses_or_answers(future: Future[Any], findings: Findings) -> None:
    error = future.exception()
    fine = error is None or isinstance(error, UnavailableError)
    findings.expect(holds=fine, problem=f"{future.describe()} while its device is absent failed with {error!r}")


def _check_recovery(bench: Bench, place: BenchRobot, findings: Findings) -> None:
    ready = comes_true(lambda: not place.robot.not_ready and not _find_unready(place), bench.ready_within_s)
    reasons = "; ".join(f"{name}: {reason}" for name, reason in (*place.robot.not_ready.items(), *_find_unready(place)))
    findings.expect(holds=ready, problem=f"its device is back, but it does not work again: {reasons}")


def _find_unready(place: BenchRobot) -> list[tuple[str, str]]:
    """Return the resources whose value is not available, with the reason."""
    values = [(name, handle.get_value()) for name, handle in _with_value(place)]
    return [(name, str(error)) for name, value in values if isinstance(error := value.exception(), UnavailableError)]


def _with_value(place: BenchRobot) -> list[tuple[str, ResourceHandle]]:
    return [(name, handle) for name, handle in place.resources.items() if "get_value" in handle.info.methods]


def keeps_calls_apart(bench: Bench, findings: Findings) -> None:
    """Concurrent calls from several threads all answer, and their bytes on the wire never interleave."""
    with bench.stand_in() as stand_in, bench.connected([stand_in]) as (place,):
        with ThreadPoolExecutor(max(2 * len(place.resources), 1)) as threads:
            asked = [threads.submit(_ask_everything, handle) for handle in place.resources.values() for _ in range(2)]
            answers = [answer for future in asked for answer in future.result()]
        for answer in answers:
            if not isinstance(answer.exception(), UnavailableError):  # a source may run dry after so many calls
                findings.answer(answer)
        for complaint in stand_in.complaints() if stand_in is not None else ():
            findings.expect(holds=False, problem=f"the emulator received invalid input: {complaint}")


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


def frees_its_port(bench: Bench, findings: Findings) -> None:
    """After closing, none of its files, ports and sockets is open."""
    if not _DESCRIPTORS.is_dir():
        return
    with bench.stand_in() as stand_in:
        with bench.connected([stand_in]):
            pass  # a first use may open files for good, such as libraries
        before = _open_files()
        with bench.connected([stand_in]) as (place,):  # fails if a port was not released before
            for _, handle in _with_value(place):
                handle.get_value().exception()
        left = _opened_since(before)
        findings.expect(holds=not left, problem=f"is still open after close: {', '.join(sorted(left.values()))}")


def _opened_since(before: dict[str, str]) -> dict[str, str]:
    """Return the files opened since; the emulator closes its end of a wire a moment after the plugin."""
    for _ in range(_LOOKS):
        left = {number: file for number, file in _open_files().items() if before.get(number) != file}
        if not left:
            break
        REAL_TIME.sleep(_LOOK_S)
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
