"""The machine's clock: whether it is right, kept right, and not set while a fleet runs."""

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
_NOT_BEFORE: Final = datetime(2025, 1, 1, tzinfo=UTC)
"""Machines without a battery wake up long before this."""
_STEP_S: Final = 0.1
_TIMEDATECTL_S: Final = 5.0
_TIME_ERROR: Final = 5
"""What adjtimex(2) answers while the clock is not synchronised."""


class StepWatch:
    """Watches whether the time of day is set while something else goes on. Thread: one at a time."""

    def __init__(self) -> None:
        self._start = wall_time()
        self._start_s = REAL_TIME.now()

    def findings(self) -> Iterator[Diagnostic]:
        """Yield what is to be said of the time since this was made."""
        passed_s = REAL_TIME.now() - self._start_s
        yield from judge_steps((wall_time() - self._start).total_seconds() - passed_s)


def check_clock() -> Iterator[Diagnostic]:
    """Yield what is to be said of the time of day. Thread: blocks the caller while it asks the system."""
    yield from judge_date(wall_time())
    yield judge_synchronised(_is_synchronised())


def judge_date(now: datetime) -> Iterator[Diagnostic]:
    """Yield what is wrong with the date itself."""
    if now < _NOT_BEFORE:
        yield problem(
            _AREA,
            f"the date is {now:%Y-%m-%d}, which cannot be: certificates are not valid yet",
            "Connect the machine to a time server, or set it: sudo date -u --set='YYYY-MM-DD hh:mm'",
        )


def judge_synchronised(synchronised: bool | None) -> Diagnostic:
    """Return what it means that a time server keeps the clock right, or does not; None is not known."""
    if synchronised:
        return ok(_AREA, "kept right by a time server")
    if synchronised is None:
        return ok(_AREA, "the system does not tell whether a time server keeps it right")
    return warning(
        _AREA,
        "no time server keeps it right: records of several machines will not fit together",
        "sudo timedatectl set-ntp true; where the network has no time server, run chrony on one machine of it",
    )


def judge_steps(step_s: float) -> Iterator[Diagnostic]:
    """Yield that the time of day was set while we looked; `step_s` is by how much, in seconds, either way."""
    if abs(step_s) > _STEP_S:
        yield warning(
            _AREA,
            f"the time of day jumped by {step_s:+.1f} s during this check; records made meanwhile have wrong times",
            "Wait until the time server has settled, or have it slew the clock; fleets run on regardless.",
        )


def _is_synchronised() -> bool | None:
    answer = _ask_kernel()
    return _ask_timedatectl() if answer is None else answer


class _Timex(ctypes.Structure):
    """`struct timex`, of which nothing but its size matters: `modes` is 0, so it is only read."""

    _fields_ = (("modes", ctypes.c_uint), ("rest", ctypes.c_long * 48))


def _ask_kernel() -> bool | None:
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(_Timex()))
    except (AttributeError, OSError):  # not Linux
        return None
    return None if state < 0 else state != _TIME_ERROR  # containers are refused


def _ask_timedatectl() -> bool | None:
    program = shutil.which("timedatectl")
    if program is None:
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
