"""The fleet for Octave: `eal_call.m` writes each call as a line of JSON, and reads its answer as one."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from robot_user import find_fleet  # type: ignore[import-not-found]  # beside this file in the image

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.device.info import METHODS
from eal_actors.kernel.errors import DeadlineError, EALError

_METHODS: Final = (*METHODS, "halt")
_CONNECT_S: Final = 30.0
"""Seconds in which a robot must answer; on a slow board it starts beside Octave."""


def answer(fleet: Fleet, line: str) -> dict[str, Any]:
    """Return the value of a call, or what was wrong with it."""
    robot, resource, method, arguments = json.loads(line)
    if method not in _METHODS:
        return {"error": f"there is no method '{method}': {', '.join(_METHODS)}"}
    try:
        with suppress(DeadlineError):  # then the call says why
            fleet[robot].wait_for_state(RobotState.READY, _CONNECT_S).get()
        result = getattr(fleet[robot][resource], method)(*arguments).get()
    except (EALError, TypeError) as error:
        return {"error": str(error)}
    value = getattr(result, "value", result)
    if isinstance(value, bytes):
        value = list(value)
    return {"value": value.tolist() if hasattr(value, "tolist") else value}


def _say(told: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Answer calls until Octave ends."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else find_fleet()
    try:
        with Fleet.load(path) as fleet:
            for line in sys.stdin:
                _say(answer(fleet, line))
    except EALError as error:
        _say({"error": str(error)})


if __name__ == "__main__":
    main()
