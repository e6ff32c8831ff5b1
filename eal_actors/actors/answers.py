"""What a resource's code returned, yielded or raised, as the answer that its caller gets."""

from __future__ import annotations

import contextlib
import numbers
from typing import Any

from eal_actors.actors.call import Call
from eal_actors.device.data import EALData
from eal_actors.device.info import ValueInfo
from eal_actors.kernel.errors import EALError, ResourceFaultError, ReturnTypeError, shown


def status_of(result: Any) -> int:
    """Return a status int: None counts as 1, the thesis's success; or raise ReturnTypeError."""
    if result is None:
        return 1
    if isinstance(result, int):
        return int(result)
    raise ReturnTypeError(f"returned {result!r} where a status int is wanted")


def seconds_of(delay_s: object) -> float:
    """Return what an activity yielded as seconds, or raise ReturnTypeError."""
    with contextlib.suppress(OverflowError):
        if isinstance(delay_s, numbers.Real) and float(delay_s) >= 0:
            return float(delay_s)
    raise ReturnTypeError(f"yielded {delay_s!r} where seconds until its next step are wanted")


def data_of(result: Any, value: ValueInfo | None) -> EALData:
    """Return the result as EALData, checked against what the resource says of it, or raise ReturnTypeError."""
    try:
        data = EALData.of(result)
    except EALError as error:
        raise ReturnTypeError(f"returned what no EALData can hold: {error}") from error
    if value is not None and (problem := value.problem(data)):
        raise ReturnTypeError(f"returned a value that {problem}")
    return data


def comm_data_of(result: Any) -> EALData:
    """Return what read_comm gave as EALData, or raise ReturnTypeError."""
    return data_of(result, None)


def explained(call: Call[Any], error: BaseException) -> EALError:
    """Return an error that names the call, and has the plugin's own error as its cause."""
    if isinstance(error, EALError) and not isinstance(error, ReturnTypeError):
        return error
    what = f"{call.method} {call.arguments[0]!r}" if call.arguments else call.method
    if isinstance(error, ReturnTypeError):
        return ReturnTypeError(f"{what} {error.message}")
    fault = ResourceFaultError(f"{what} raised {shown(error)}")
    fault.__cause__ = error
    return fault
