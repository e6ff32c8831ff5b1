"""The typed handle of one resource: it names a resource, so it survives a restart of what it names."""

from __future__ import annotations

import math
from typing import Any

from eal_actors.actors.answers import data_of
from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.feeds import Encoding, Feed, Sink, StreamSpec
from eal_actors.actors.polling import PolledFeed
from eal_actors.actors.streams import Stream
from eal_actors.actors.waiting import Waiting, waiting_in
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.device.link import Link
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import ArgumentError


def _as_data(value: Any) -> EALData | None:
    return None if value is None else EALData.of(value)


class ResourceHandle:
    """One resource of one robot. Every call returns a future at once, and never blocks.

    A call fails through its future: BusyError when the mailbox is full, UnavailableError while the resource is
    restarting, DeadlineError when no answer came in time, UnsupportedError when the resource lacks the method,
    ArgumentError when it refuses the argument, ResourceFaultError when its own code raised. `timeout_s` is in seconds
    of the fleet's clock; None takes the fleet file's default.

    Thread: any; handles may be shared.
    """

    __slots__ = ("_cell",)

    def __init__(self, cell: ResourceCell) -> None:
        self._cell = cell

    def __repr__(self) -> str:
        return f"<ResourceHandle {self._cell.robot}/{self._cell.name}>"

    @property
    def name(self) -> str:
        """The resource's name on its robot."""
        return self._cell.name

    @property
    def robot(self) -> str:
        """The robot's name."""
        return self._cell.robot

    @property
    def link(self) -> Link:
        """What calls pass on their way."""
        return self._cell.link

    @property
    def info(self) -> ResourceInfo:
        """What the resource says of itself.

        Raises:
            UnavailableError: it has never been up.
        """
        if self._cell.info is None:
            raise self._cell.unavailable()
        return self._cell.info

    @property
    def waiting(self) -> Waiting | None:
        """What waits in its mailbox; None where that is in another process. Thread: any; does not block."""
        return waiting_in(self._cell)

    def start_call(
        self,
        method: str,
        arguments: tuple[Any, ...],
        timeout_s: float,
        begin_by_s: float | None = None,
        start_s: float | None = None,
    ) -> Call[Any]:
        """Call any method with its packed arguments, in the lane where it belongs: for servers.

        Args:
            method: one of the nine methods, or `halt`.
            arguments: the method's arguments, values as EALData.
            timeout_s: seconds of the fleet's clock until its deadline.
            begin_by_s: the fleet's time after which it must not begin any more; None for none.
            start_s: the fleet's time at which to begin; None for at once, as stops always do.

        Thread: any; does not block.
        """
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, timeout_s)
        call.begin_by_s, call.start_s = begin_by_s, start_s
        info = cell.info
        stops = method == "halt" or (method == "send_cmd" and info is not None and arguments[0] in info.urgent_commands)
        if stops or method == "get_status":
            cell.submit_urgent(call, stops=stops)
        else:
            cell.submit(call)
        return call

    def open_feed(self, spec: StreamSpec, sink: Sink) -> Feed:
        """Have values brought to a sink until the feed is closed: for servers. Thread: any; does not block."""
        return PolledFeed(self._cell, spec, sink)

    def _call(
        self, method: str, arguments: tuple[Any, ...], timeout_s: float | None, at_s: float | None = None
    ) -> Call[Any]:
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, cell.timeout_s if timeout_s is None else timeout_s)
        if at_s is not None:
            if not math.isfinite(at_s):
                call.fail(ArgumentError(f"at_s must be a time of the fleet's clock, not {at_s!r}"))
                return call
            call.start_s = at_s
        cell.submit(call)
        return call

    def _urgent_call(
        self, method: str, arguments: tuple[Any, ...], timeout_s: float | None, *, stops: bool
    ) -> Call[Any]:
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, cell.timeout_s if timeout_s is None else timeout_s)
        cell.submit_urgent(call, stops=stops)
        return call

    def get_status(self, *, timeout_s: float | None = None) -> Call[int]:
        """Ask for the status; overtakes what waits, and is answered while a command runs."""
        return self._urgent_call("get_status", (), timeout_s, stops=False)

    def get_value(self, *, timeout_s: float | None = None) -> Call[EALData]:
        """Ask for the value."""
        return self._call("get_value", (), timeout_s)

    def glance(self) -> EALData | None:
        """Return the value at once if this process knows it, without a call; None where get_value must ask.

        It is for whoever looks at very many resources very often: it passes the mailbox by, in the caller's thread.
        What is in another process, behind a faulty link, not up, or fails, is not known.

        Thread: any; does not block.
        """
        cell, actor = self._cell, self._cell.actor
        if actor is None or cell.open_feed is not None or cell.link.is_faulty:
            return None
        try:
            if (resource := actor.resource) is None or (value := resource.glance()) is None:
                return None
            return data_of(value, resource.value)
        except Exception:  # noqa: BLE001  # a plugin may raise anything; whoever asks by get_value is told what is wrong
            return None

    def set_value(self, value: Any, *, timeout_s: float | None = None, at_s: float | None = None) -> Call[int]:
        """Set the value; the answer is a status int. `at_s` is as with send_cmd."""
        return self._call("set_value", (EALData.of(value),), timeout_s, at_s)

    def send_req(self, req: str, *, timeout_s: float | None = None) -> Call[EALData]:
        """Send a request; the answer is its data."""
        return self._call("send_req", (req,), timeout_s)

    def send_cmd(
        self, cmd: str, data: Any = None, *, timeout_s: float | None = None, at_s: float | None = None
    ) -> Call[int]:
        """Send a command; the future is done when the command is, with a status int.

        Its `progress()` is how far it has come, where the resource tells.

        A newer command takes over from a running one, whose future fails with PreemptedError. A stop overtakes
        everything that waits, and drops the commands that wait.

        Args:
            cmd: the command.
            data: its argument, where its text does not hold it.
            timeout_s: seconds of the fleet's clock until its deadline, which counts from now on.
            at_s: when to begin, by the fleet's clock; None, or a time that is past when the resource reads it, for at
                once. Until then the resource goes on with what it does, and a newer command or a stop calls it off
                with PreemptedError. Stops take no time: they begin at once.
        """
        info, arguments = self._cell.info, (cmd, _as_data(data))
        if info is not None and cmd in info.urgent_commands:
            return self._urgent_call("send_cmd", arguments, timeout_s, stops=True)
        return self._call("send_cmd", arguments, timeout_s, at_s)

    def read_comm(self, length: int, *, timeout_s: float | None = None) -> Call[EALData]:
        """Read up to `length` bytes; the answer holds what was read."""
        return self._call("read_comm", (length,), timeout_s)

    def write_comm(self, data: Any, length: int | None = None, *, timeout_s: float | None = None) -> Call[int]:
        """Write the first `length` bytes, all if None; the answer is how many were written."""
        packed = EALData.of(data)
        return self._call("write_comm", (packed, packed.length if length is None else length), timeout_s)

    def get_config(self, key: str, *, timeout_s: float | None = None) -> Call[EALData]:
        """Ask for a configuration value."""
        return self._call("get_config", (key,), timeout_s)

    def set_config(self, key: str, value: Any = None, *, timeout_s: float | None = None) -> Call[int]:
        """Set a configuration value; the answer is a status int."""
        return self._call("set_config", (key, _as_data(value)), timeout_s)

    def halt(self, *, timeout_s: float | None = None) -> Call[int]:
        """Stop what moves, at once: overtakes everything, closes the running command, drops those that wait."""
        return self._urgent_call("halt", (), timeout_s, stops=True)

    def stream(self, rate_hz: float = 10.0, encoding: Encoding = "raw", *, timeout_s: float | None = None) -> Stream:
        """Read the newest value again and again; see Stream. Close it, as a `with` block does.

        Args:
            rate_hz: values in a second of the fleet's clock, at most; over 0, up to 1000.
            encoding: how images travel through a network: `raw`, `jpeg` (small, loses a little) or `png` (loses
                nothing). The reader gets an image in any case; within a process nothing is encoded.
            timeout_s: how long a reader waits for a value; None for the fleet file's default and one period.

        Raises:
            ArgumentError: such a rate or encoding does not exist, or the value is no uint8 image (height, width, 3).
            UnsupportedError: the resource has no value; or OpenCV is needed for the encoding and not installed.

        Thread: any; does not block.
        """
        spec = StreamSpec(rate_hz, encoding)
        return Stream(self._cell, spec, self._cell.timeout_s + spec.period_s if timeout_s is None else timeout_s)

    def resource(self) -> Resource:
        """Return the resource object itself (Source: thesis B.2.4). For debugging: its actor still uses it.

        Raises:
            UnavailableError: it is not up.
        """
        actor = self._cell.actor
        if actor is None or actor.resource is None:
            raise self._cell.unavailable()
        return actor.resource
