"""The same call to many resources at once.

This is the one place that sees such calls together, so it decides how they travel. In this process, a call runs in the
caller's thread where its resource allows that and is idle: waking a thread for each costs several times the work.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from eal_actors.actors.call import Call
from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.resource_handle import ResourceHandle
from eal_actors.device.data import EALData


def read_many(handles: Sequence[ResourceHandle], timeout_s: float | None = None) -> list[Call[EALData]]:
    """Read the values of many resources; return the calls in the same order.

    `timeout_s` is seconds of the fleet's clock until the deadline of each call; None for the fleet file's default.
    Thread: any; runs the resources' code where it may run in any thread, and does not wait.
    """
    return [handle.call_among_many("get_value", (), timeout_s) for handle in handles]


def send_many(
    handles: Sequence[ResourceHandle], cmd: str, data: Any = None, timeout_s: float | None = None
) -> list[Call[int]]:
    """Send a command to many resources; return the calls in the same order.

    `cmd`, `data` and `timeout_s` are as for `ResourceHandle.send_cmd`; a stop overtakes what waits, as there. Thread:
    any; runs the resources' code where it may run in any thread, and does not wait.
    """
    arguments = cmd, None if data is None else EALData.of(data)
    return [
        handle.send_cmd(cmd, data, timeout_s=timeout_s)
        if handle.is_stop(cmd)
        else handle.call_among_many("send_cmd", arguments, handle.command_timeout_s(cmd, timeout_s))
        for handle in handles
    ]


def by_robot(
    handles: Sequence[ResourceHandle], calls: Sequence[Call[Any]], *, return_exceptions: bool = False
) -> Future[dict[str, Any]]:
    """Return one future of the results of calls to different robots, by the robots' names; see `gather`.

    Thread: any; does not block.
    """
    names = [handle.robot for handle in handles]
    return gather(calls, return_exceptions=return_exceptions).map(lambda values: dict(zip(names, values, strict=True)))
