"""The typed handle of one resource. It names the resource, so it survives a restart."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.feeds import Feed, Sink, StreamSpec
from eal_actors.actors.future import Future, Relay
from eal_actors.actors.resource_actor import data_of
from eal_actors.actors.robot_view import MailboxLoad, mailbox_load
from eal_actors.actors.streams import PolledFeed, Stream
from eal_actors.device.data import EALData
from eal_actors.device.data.images import Encoding
from eal_actors.device.info import ResourceInfo
from eal_actors.device.link import FaultyLink
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import ArgumentError


class ResourceHandle:
    """One resource of one robot. Every call returns a future at once and never blocks.

    A call fails through its future: BusyError when the mailbox is full, UnavailableError while the resource is
    restarting, DeadlineError when no answer came in time, UnsupportedError when the resource lacks the method,
    ArgumentError when it refuses the argument, ResourceFaultError when its own code raised. `timeout_s` is in seconds
    of the fleet's clock and defaults to the fleet file's.

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
    def link(self) -> FaultyLink:
        """The link that calls pass."""
        return self._cell.link

    @property
    def info(self) -> ResourceInfo:
        """The resource's information about itself.

        Raises:
            UnavailableError: it has never been up.
        """
        if self._cell.info is None:
            raise self._cell.unavailable()
        return self._cell.info

    def denied(self, method: str) -> str | None:
        """Return why the robot does not grant this program a method; None if it does. Thread: any; does not block."""
        return self._cell.denied(method)

    @property
    def waiting(self) -> MailboxLoad | None:
        """The load of its mailbox; None if that is in another process. Thread: any; does not block."""
        return mailbox_load(self._cell)

    def start_call(
        self,
        method: str,
        arguments: tuple[Any, ...],
        timeout_s: float,
        begin_by_s: float | None = None,
        start_s: float | None = None,
        prepare: Callable[[Call[Any]], Relay] | None = None,
    ) -> Call[Any]:
        """Call any method with its packed arguments, in the lane where it belongs; for servers.

        Args:
            method: one of the nine methods, or `halt`.
            arguments: the method's arguments, values as EALData.
            timeout_s: seconds of the fleet's clock until its deadline.
            begin_by_s: the latest time of the fleet's clock to begin it; None for no limit.
            start_s: the time of the fleet's clock to begin it; None for at once, as stops always do.
            prepare: called with the call before anybody else has it; returns what gets its outcome, see `Future.link`.

        Thread: any; does not block.
        """
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, timeout_s)
        call.begin_by_s, call.start_s = begin_by_s, start_s
        if prepare is not None:
            call._relays = [*(call._relays or ()), prepare(call)]  # no lock is needed yet
        info = cell.info
        stops = method == "halt" or (method == "send_cmd" and info is not None and arguments[0] in info.urgent_commands)
        if stops or method == "get_status":
            cell.submit_urgent(call, stops=stops)
        else:
            cell.submit(call)
        return call

    def start_reading(self, method: str, arguments: tuple[Any, ...], timeout_s: float, relay: Relay) -> None:
        """Call a method that changes nothing, as start_call; `relay` gets the outcome, see `Future.link`.

        Thread: any; does not block. Reads a value that takes no time (`Resource.glance`), if nothing waits before it.
        """
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, timeout_s)
        call._relays = [*(call._relays or ()), relay]  # no lock is needed: nobody else has the call yet
        if method == "get_status":
            cell.submit_urgent(call, stops=False)
        elif method != "get_value" or cell.read_now is None or cell.link.is_faulty or not cell.read_now(call):
            cell.submit(call)

    @property
    def reads_now(self) -> bool:
        """Whether `start_reading` may read its value in the caller's thread. Thread: any."""
        return self._cell.read_now is not None

    def open_feed(self, spec: StreamSpec, sink: Sink) -> Feed:
        """Deliver values to a sink until the feed is closed; for servers. Thread: any; does not block."""
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

    def call_among_many(self, method: str, arguments: tuple[Any, ...], timeout_s: float | None) -> Call[Any]:
        """Make one of many calls to different resources; see `eal_actors.actors.many`. Thread: any; does not block."""
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, cell.timeout_s if timeout_s is None else timeout_s)
        cell.submit(call, among_many=True)
        return call

    def is_stop(self, cmd: str) -> bool:
        """Return whether a command stops what moves, so that it overtakes everything that waits. Thread: any."""
        return self._cell.info is not None and cmd in self._cell.info.urgent_commands

    def _urgent_call(
        self, method: str, arguments: tuple[Any, ...], timeout_s: float | None, *, stops: bool
    ) -> Call[Any]:
        cell = self._cell
        call: Call[Any] = Call(cell, method, arguments, cell.timeout_s if timeout_s is None else timeout_s)
        cell.submit_urgent(call, stops=stops)
        return call

    def get_status(self, *, timeout_s: float | None = None) -> Call[int]:
        """Return the status. The call overtakes those that wait, and is answered while a command runs."""
        return self._urgent_call("get_status", (), timeout_s, stops=False)

    def get_value(self, *, timeout_s: float | None = None) -> Call[EALData]:
        """Return the value."""
        cell = self._cell  # as _call, in every reading
        call: Call[EALData] = Call(cell, "get_value", (), cell.timeout_s if timeout_s is None else timeout_s)
        cell.submit(call)
        return call

    def glance(self) -> EALData | None:
        """Return the value at once if this process knows it, without a call; None where get_value must ask.

        For callers that read very many resources very often: it bypasses the mailbox, in the caller's thread. The value
        is unknown if the resource is in another process, behind a faulty link or not up, or if reading fails.

        Thread: any; does not block.
        """
        cell, actor = self._cell, self._cell.actor
        if actor is None or cell.open_feed is not None or cell.link.is_faulty:
            return None
        try:
            if (resource := actor.resource) is None or (value := resource.glance()) is None:
                return None
            return data_of(value, resource.value)
        except Exception:  # noqa: BLE001  # a plugin may raise anything; get_value reports what is wrong
            return None

    def set_value(self, value: Any, *, timeout_s: float | None = None, at_s: float | None = None) -> Call[int]:
        """Set the value; returns a status int. `at_s` as in send_cmd."""
        return self._call("set_value", (EALData.of(value),), timeout_s, at_s)

    def send_req(self, req: str, *, timeout_s: float | None = None) -> Call[EALData]:
        """Send a request; returns its data."""
        return self._call("send_req", (req,), timeout_s)

    def send_cmd(
        self, cmd: str, data: Any = None, *, timeout_s: float | None = None, at_s: float | None = None
    ) -> Call[int]:
        """Send a command; the future is done when the command is, with a status int.

        The future's `progress()` is the command's progress, where the resource reports it. A newer command replaces a
        running one, whose future fails with PreemptedError. A stop overtakes everything that waits and drops the
        commands that wait.

        Args:
            cmd: the command.
            data: its argument, where its text does not hold it.
            timeout_s: seconds of the fleet's clock until its deadline, which counts from now on; None for the fleet
                file's default, and for a motion over a distance or angle the time that it takes in addition.
            at_s: when to begin, by the fleet's clock; None, or a time that has passed when the resource reads it, for
                at once. Until then the resource continues what it does, and a newer command or a stop cancels this one
                with PreemptedError. Stops take no time: they begin at once.
        """
        arguments = cmd, None if data is None else EALData.of(data)
        info = self._cell.info
        if info is not None and cmd in info.urgent_commands:  # as is_stop
            return self._urgent_call("send_cmd", arguments, timeout_s, stops=True)
        return self._call("send_cmd", arguments, self.command_timeout_s(cmd, timeout_s), at_s)

    def command_timeout_s(self, cmd: str, timeout_s: float | None) -> float | None:
        """Return the time limit of a command: the given one, else one that allows for what it takes. Thread: any."""
        info = self._cell.info
        return timeout_s if timeout_s is not None or info is None else self._cell.timeout_s + info.takes_s(cmd)

    def read_comm(self, length: int, *, timeout_s: float | None = None) -> Call[EALData]:
        """Read up to `length` bytes; returns the bytes read."""
        return self._call("read_comm", (length,), timeout_s)

    def write_comm(self, data: Any, length: int | None = None, *, timeout_s: float | None = None) -> Call[int]:
        """Write the first `length` bytes, all if None; returns how many were written."""
        packed = EALData.of(data)
        return self._call("write_comm", (packed, packed.length if length is None else length), timeout_s)

    def get_config(self, key: str, *, timeout_s: float | None = None) -> Call[EALData]:
        """Return a configuration value."""
        return self._call("get_config", (key,), timeout_s)

    def set_config(self, key: str, value: Any = None, *, timeout_s: float | None = None) -> Call[int]:
        """Set a configuration value; returns a status int. Default deadlines of motions follow a speed that it sets."""
        data = None if value is None else EALData.of(value)
        call = self._call("set_config", (key, data), timeout_s)
        if data is not None and isinstance(data.value, (int, float)):
            call.add_done_callback(lambda done: self._follow_pace(key, data.value, done))
        return call

    def _follow_pace(self, key: str, value: float, done: Future[int]) -> None:
        info = self._cell.info
        if info is not None and done.exception() is None:
            self._cell.info = info.at_pace(key, value)

    def halt(self, *, timeout_s: float | None = None) -> Call[int]:
        """Stop everything that moves, at once: overtake all calls, close the running command, drop those that wait."""
        return self._urgent_call("halt", (), timeout_s, stops=True)

    def halt_because(self, reason: str) -> Call[int]:
        """Halt a resource of this process; what was running fails with the reason."""
        return self._urgent_call("halt", (f"halted: {reason}",), None, stops=True)

    def stream(self, rate_hz: float = 10.0, encoding: Encoding = "raw", *, timeout_s: float | None = None) -> Stream:
        """Read the newest value again and again; see Stream. Close it, as a `with` block does.

        Args:
            rate_hz: values in a second of the fleet's clock, at most; over 0, up to 1000.
            encoding: the encoding of images on a network: `raw`, `jpeg` (small, loses a little) or `png` (loses
                nothing). The reader always gets an image; within a process nothing is encoded.
            timeout_s: how long a reader waits for a value; None for the fleet file's default and one period.

        Raises:
            ArgumentError: the rate or encoding is invalid, or the value is no uint8 image (height, width, 3).
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
