"""Checks of how a plugin treats its wire: what it does when it is pulled out, shared and let go of."""

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
from eal_actors.testing.conformance.bench import Bench, Findings, Place, comes_true

_DESCRIPTORS: Final = Path("/proc/self/fd")
_ROUNDS: Final = 5
_LOOK_S: Final = 0.1
_LOOKS: Final = 20


def waits_for_its_device(bench: Bench, findings: Findings) -> None:
    """Connected while its device is away, it comes up, says that it is not ready, and works when the device comes."""
    with bench.stand_in() as stand_in:
        if stand_in is None:
            return
        stand_in.unplug()
        with bench.connected([stand_in], ready=False) as (place,):
            findings.expect(
                holds=bool(place.robot.not_ready), problem="its device is absent, but no resource says it is not ready"
            )
            stand_in.plug_in()
            _works_again(bench, place, findings)


def bears_unplugging(bench: Bench, findings: Findings) -> None:
    """When its device is pulled out, calls fail with NotReadyError at once; when it is back, all works on."""
    with bench.stand_in() as stand_in:
        if stand_in is None:
            return
        with bench.connected([stand_in]) as (place,):
            stand_in.unplug()
            gone = comes_true(lambda: bool(place.robot.not_ready), bench.ready_within_s)
            if findings.expect(holds=gone, problem="its device was pulled out, but no resource says it is not ready"):
                for name in place.robot.not_ready:
                    findings.refusal(_ask(place.resources[name]), NotReadyError)
                for handle in place.resources.values():
                    _refuses_or_answers(handle.halt(), findings)
            stand_in.plug_in()
            _works_again(bench, place, findings)


def _ask(handle: ResourceHandle) -> Future[Any]:
    """Make a call that every resource refuses in its own way, but with NotReadyError before that."""
    return handle.get_config("eal-conformance-nobody")


def _refuses_or_answers(future: Future[Any], findings: Findings) -> None:
    error = future.exception()
    fine = error is None or isinstance(error, UnavailableError)
    findings.expect(holds=fine, problem=f"{future.describe()} while its device is away failed with {error!r}")


def _works_again(bench: Bench, place: Place, findings: Findings) -> None:
    ready = comes_true(lambda: not place.robot.not_ready and not _unready(place), bench.ready_within_s)
    reasons = "; ".join(f"{name}: {reason}" for name, reason in (*place.robot.not_ready.items(), *_unready(place)))
    findings.expect(holds=ready, problem=f"its device is back, but it does not work again: {reasons}")


def _unready(place: Place) -> list[tuple[str, str]]:
    """Return which resources do not give their value, and why."""
    values = [(name, handle.get_value()) for name, handle in _with_value(place)]
    return [(name, str(error)) for name, value in values if isinstance(error := value.exception(), UnavailableError)]


def _with_value(place: Place) -> list[tuple[str, ResourceHandle]]:
    return [(name, handle) for name, handle in place.resources.items() if "get_value" in handle.info.methods]


def keeps_calls_apart(bench: Bench, findings: Findings) -> None:
    """Calls from several threads at once all answer, and what they send to the device never interleaves."""
    with bench.stand_in() as stand_in, bench.connected([stand_in]) as (place,):
        with ThreadPoolExecutor(max(2 * len(place.resources), 1)) as threads:
            asked = [threads.submit(_ask_everything, handle) for handle in place.resources.values() for _ in range(2)]
            answers = [answer for future in asked for answer in future.result()]
        for answer in answers:
            if not isinstance(answer.exception(), UnavailableError):  # a source may run dry when it is asked so often
                findings.answer(answer)
        for complaint in stand_in.complaints() if stand_in is not None else ():
            findings.expect(holds=False, problem=f"the emulator was sent what makes no sense: {complaint}")


def _ask_everything(handle: ResourceHandle) -> list[Future[Any]]:
    """Ask for everything, and set what can be set to what it is."""
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
            if key.writable and (data := _answered(present)) is not None:
                answers.append(handle.set_config(key.name, data))
        for answer in answers:
            answer.exception()
    return answers


def _answered(future: Future[EALData]) -> EALData | None:
    try:
        return future.get()
    except EALError:
        return None


def frees_its_port(bench: Bench, findings: Findings) -> None:
    """Closed, it has let go of everything that it had opened: files, ports and sockets."""
    if not _DESCRIPTORS.is_dir():
        return
    with bench.stand_in() as stand_in:
        with bench.connected([stand_in]):
            pass  # what a first use opens for good, such as a library, is no business of the plugin's
        before = _open_files()
        with bench.connected([stand_in]) as (place,):  # not ready, where a port was not let go of before
            for _, handle in _with_value(place):
                handle.get_value().exception()
        left = _opened_since(before)
        findings.expect(holds=not left, problem=f"is still open after close: {', '.join(sorted(left.values()))}")


def _opened_since(before: dict[str, str]) -> dict[str, str]:
    """Return what is open beyond that; the stand-in's own end of a line closes a moment after the plugin's."""
    for _ in range(_LOOKS):
        left = {number: file for number, file in _open_files().items() if before.get(number) != file}
        if not left:
            break
        REAL_TIME.sleep(_LOOK_S)
    return left


def _open_files() -> dict[str, str]:
    """Return what this process has open, by the number of the descriptor."""
    found = {}
    for entry in os.listdir(_DESCRIPTORS):  # noqa: PTH208  # a Path's own listing would follow what vanishes meanwhile
        try:
            found[entry] = os.readlink(_DESCRIPTORS / entry)  # noqa: PTH115
        except OSError:
            continue  # the descriptor of the listing itself
    return found
