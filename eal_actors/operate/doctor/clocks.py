"""Checks of the machine's clock: its date, its synchronisation, and steps during the check."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Final

from eal_actors.kernel.clock import REAL_TIME, wall_time
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

_AREA: Final = "clock"
_NOT_BEFORE: Final = datetime(2025, 1, 1, tzinfo=UTC)  # machines without a clock battery start with an earlier date
_STEP_S: Final = 0.1
_TIMEDATECTL_S: Final = 5.0
_TIME_ERROR: Final = 5  # the state of adjtimex(2) for a clock that is not synchronised


class StepWatch:
    """Detects steps of the time of day. Thread: one at a time."""

    def __init__(self) -> None:
        self._start = wall_time()
        self._start_s = REAL_TIME.now()

    def findings(self) -> Iterator[Diagnostic]:
        """Yield a diagnostic if the time of day was set since this object was made."""
        passed_s = REAL_TIME.now() - self._start_s
        yield from judge_steps((wall_time() - self._start).total_seconds() - passed_s)


def check_clock() -> Iterator[Diagnostic]:
    """Yield diagnostics of the time of day. Thread: blocks the caller while it asks the system."""
    yield from judge_date(wall_time())
    asked = _ask_kernel()
    yield judge_synchronised(_ask_timedatectl() if asked is None else asked)


def judge_date(now: datetime) -> Iterator[Diagnostic]:
    """Yield a problem if the date is impossible."""
    if now < _NOT_BEFORE:
        advice = "Connect the machine to a time server, or set it: sudo date -u --set='YYYY-MM-DD hh:mm'"
        yield problem(_AREA, f"the date {now:%Y-%m-%d} is wrong, so certificates are not valid yet", advice)


def judge_synchronised(synchronised: bool | None) -> Diagnostic:
    """Return the diagnostic of the synchronisation with a time server; None for unknown."""
    if synchronised:
        return ok(_AREA, "synchronised with a time server")
    if synchronised is None:
        return ok(_AREA, "the system does not report whether it is synchronised with a time server")
    what = "not synchronised with a time server: times in records of different machines will differ"
    advice = "sudo timedatectl set-ntp true; in a network without a time server, run chrony on one machine"
    return warning(_AREA, what, advice)


def judge_steps(step_s: float) -> Iterator[Diagnostic]:
    """Yield a warning if the time of day stepped during the check, by `step_s` seconds."""
    if abs(step_s) > _STEP_S:
        what = f"the time of day jumped by {step_s:+.1f} s during this check; current records have wrong times"
        advice = (
            "Wait for the time synchronisation to settle, or let it slew the clock. Running fleets are not affected."
        )
        yield warning(_AREA, what, advice)


class _Timex(ctypes.Structure):
    """`struct timex`. Only its size matters: with `modes` 0 the call only reads."""

    _fields_ = (("modes", ctypes.c_uint), ("rest", ctypes.c_long * 48))


def _ask_kernel() -> bool | None:
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(_Timex()))
    except (AttributeError, OSError):  # not Linux
        return None
    return None if state < 0 else state != _TIME_ERROR  # refused in containers


def _ask_timedatectl() -> bool | None:
    if (program := shutil.which("timedatectl")) is None:
        return None
    command = [program, "show", "--property=NTPSynchronized", "--value"]
    try:
        answer = subprocess.run(  # noqa: S603  # a fixed command of the system
            command,
            capture_output=True,
            text=True,
            timeout=_TIMEDATECTL_S,
            check=False,
            env={**os.environ, "LC_ALL": "C"},
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return {"yes": True, "no": False}.get(answer.stdout.strip())
