"""LocalLink: a socket between two processes of one user on one machine, for calls and their replies.

A message of the engine passes two of its threads and the system's network in each direction, which is half of a call.
A packet socket of the system's own passes neither: the thread that has a message puts it into the other end's buffer,
and a Python thread of that process takes it out. So a controller dials the process of a robot once they have shaken
hands over the engine. All else stays with the engine: tokens, heartbeats, events, streams and large values; and the
calls too where a dial fails, as it does between two machines or two users.

- The socket's name is in Linux's abstract namespace, so there is no file: nothing is left of a process that is killed.
- Such a name has no permissions. So each end asks the kernel for the user of the other one, and the name contains the
  random number of the robot's process, which comes with the handshake.
- A proxy or a tunnel is not bypassed: the dialling end names the port of its link, and the other one must have a link
  at that port.
- The system takes a packet as a whole or not at all. So one that it refuses may go over the engine instead.
- A call whose packet finds no room for a while ends the link, and calls take the engine from then on.
- A fleet with certificates has no such links: there the engine checks who may call what.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import struct
import threading
from collections.abc import Callable
from functools import partial
from typing import Final

import msgpack

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import error_text
from eal_actors.kernel.log import get_logger
from eal_actors.managers.network_model import BEHIND_ROUTER, parse_endpoint
from eal_actors.wire import engine_exit
from eal_actors.wire.format import parts
from eal_actors.wire.format.packing import PROTOCOL_VERSION
from eal_actors.wire.transport import Receive

_MOST_BYTES: Final = 64 * 1024
"""Limit of a packet."""
_BUFFER_BYTES: Final = 208 * 1024
"""Buffer of a link, the most that Linux grants by default: several hundred calls."""
_MOST_LINKS: Final = 16
"""Limit of the links of one robot's process; further controllers use the engine."""
_MOST_KNOWN: Final = 256
"""Processes that are remembered, as each restart of a robot is another one."""
_GREETING_S: Final = 2.0
"""Real seconds within which each end must greet the other; a busy machine may need one."""
_STALLED_S: Final = 0.5
"""Real seconds after which a call that waits for a full buffer ends the link, as it does in the engine."""
_NO_DESCRIPTOR_S: Final = 0.1
"""Real seconds between two attempts to accept a link while no descriptor is free."""
_CREDENTIALS: Final = "3i"
_YES: Final = b"\x01"

_pack: Final = msgpack.Packer().pack


class LocalLink:
    """One end of a link, by a connected socket. Thread: any may send; one reads."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)

    def send(self, head: str, envelope: bytes, payload: Payload) -> bool:
        """Send a message at once, by a key or a robot; return False if there is no room for it, or nobody there."""
        packet = _pack((head, envelope, payload))
        if len(packet) > _MOST_BYTES:
            return False
        try:
            self._socket.send(packet, socket.MSG_DONTWAIT)
        except OSError:
            return False
        return True

    def send_patiently(self, head: str, envelope: bytes, payload: Payload) -> bool:
        """Send a message, as `send`; if there is no room in time, the link ends. Thread: one that may wait."""
        if self.send(head, envelope, payload):
            return True
        with contextlib.suppress(OSError, ValueError):  # it is closed
            poll = select.poll()
            poll.register(self._socket, select.POLLOUT)
            if poll.poll(1000 * _STALLED_S) and self.send(head, envelope, payload):
                return True
        self.close()
        return False

    def read(self, receive: Receive) -> None:
        """Handle messages until the link ends, at the latest with one that is malformed. Thread: blocks the caller."""
        buffer = memoryview(bytearray(_MOST_BYTES + 1))
        unpack, receive_into = msgpack.unpackb, self._socket.recv_into
        with contextlib.suppress(OSError):  # it has ended
            while length := receive_into(buffer):
                try:
                    head, envelope, payload = unpack(buffer[:length])
                except (ValueError, TypeError, msgpack.UnpackException):
                    return
                if type(head) is not str or type(envelope) is not bytes or type(payload) is not bytes:
                    return
                if engine_exit.has_begun:
                    return
                try:
                    receive(head, envelope, payload)
                except Exception as error:  # noqa: BLE001  # as Transport does; one bad message must not end the thread
                    get_logger().exception("a message was not handled", error=error_text(error))

    def start(self, receive: Receive, on_end: Callable[[LocalLink], None], name: str) -> None:
        """Read in a thread of its own; `on_end` is called there when the link has ended."""

        def work() -> None:
            forget = engine_exit.close_at_exit(self.close)
            try:
                self.read(receive)
            finally:
                forget()
                self.close()
                self._socket.close()
                on_end(self)

        engine_exit.start_thread(work, name)

    def close(self) -> None:
        """End the link at both ends; harmless if it has ended. Thread: any; does not block."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)


def dial(process: str, port: int) -> LocalLink | None:
    """Return a link to the process of a robot; None if it is on another machine, of another user, or refuses.

    The robot names its process in the handshake; the port is that of its address. Thread: blocks the caller for a
    moment.
    """
    with contextlib.suppress(OSError), contextlib.ExitStack() as stack:
        end = stack.enter_context(_packet_socket())
        end.settimeout(_GREETING_S)
        end.connect(_name(process))
        if _is_own(end) and end.send(str(port).encode()) and end.recv(1) == _YES:
            end.settimeout(None)
            stack.pop_all()
            return LocalLink(end)
    return None


class LocalLinks:
    """A controller's links by process, and in `links` by robot. Thread: any; that of a link handles its replies.

    When a link has ended, `on_lost` is called with each of its robots, in the link's thread.

    A robot has its link from the handshake on until its token changes, so that all its calls take one way and none
    overtakes another. When a link ends alone, the calls on it are lost like those of a broken link of the engine: the
    ones that change nothing are made again, and the robot is asked for the outcomes of the others.
    """

    def __init__(self, receive: Receive, on_lost: Callable[[str], None], *, is_on: bool) -> None:
        self.links: Final[dict[str, LocalLink]] = {}
        self._receive = receive
        self._on_lost = on_lost
        self._is_on = is_on
        self._lock = threading.Lock()
        self._processes: dict[str, LocalLink | None] = {}  # None for those that have refused

    def connect(self, robot: str, process: str, address: str) -> None:
        """Give a robot a link to its process, if that is on this machine. Thread: blocks the caller for a moment."""
        if not self._is_on or not process or address == BEHIND_ROUTER:
            return
        with self._lock:
            if process not in self._processes:  # it is dialled once, also if it serves a thousand robots
                if len(self._processes) >= _MOST_KNOWN:
                    self._processes = {known: link for known, link in self._processes.items() if link is not None}
                self._processes[process] = dialled = dial(process, parse_endpoint(address).port)
                if dialled is not None:
                    dialled.start(self._receive, self._forget, "local replies")
            if (link := self._processes[process]) is not None:
                self.links[robot] = link
            else:
                self.disconnect(robot)

    def disconnect(self, robot: str) -> None:
        """Take a robot's link away, which others may still use."""
        self.links.pop(robot, None)

    def put(self, robot: str, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool) -> bool | None:
        """Send a call, in parts if it is large; return None if it must go over the engine; see Controller.put."""
        link = self.links.get(robot)
        if link is None:
            return None
        if is_urgent:  # where the link has no room, the engine may
            return link.send(key, envelope, payload) or None
        return all(link.send_patiently(key, *part) for part in parts.split(envelope, payload))

    def _forget(self, link: LocalLink) -> None:
        with self._lock:
            self._processes = {process: other for process, other in self._processes.items() if other is not link}
            robots = [robot for robot, other in list(self.links.items()) if other is link]
            for robot in robots:
                self.disconnect(robot)
        for robot in robots:
            self._on_lost(robot)

    def close(self) -> None:
        """End all links."""
        with self._lock:
            self._is_on = False
            links = list(self._processes.values())
        for link in links:
            if link is not None:
                link.close()


class LocalListener:
    """Accepts the links of controllers on the same machine. Thread: any.

    `process` identifies this process, see `dial`; `has_link_at` returns whether it has a link of the engine at a port.
    `receive` gets a link and a message as Receive describes it, in a thread for each link. Raises OSError if there
    can be no link here.
    """

    def __init__(self, process: str, has_link_at: Callable[[int], bool], receive: Callable[..., None]) -> None:
        self._has_link_at = has_link_at
        self._receive = receive
        self._lock = threading.Lock()
        self._links: set[LocalLink] = set()
        self._listener = _packet_socket()
        try:
            self._listener.bind(_name(process))
            self._listener.listen(_MOST_LINKS)
        except OSError:
            self._listener.close()
            raise
        self._forget = engine_exit.close_at_exit(self.close)
        engine_exit.start_thread(self._accept, "local links")

    def _accept(self) -> None:
        while True:
            try:
                end, _ = self._listener.accept()
            except OSError as error:
                if error.errno not in (errno.EMFILE, errno.ENFILE):  # it is closed
                    return
                REAL_TIME.sleep(_NO_DESCRIPTOR_S)
                continue
            try:
                is_welcome = self._greet(end)
            except (OSError, ValueError):
                is_welcome = False
            if not is_welcome:
                end.close()

    def _greet(self, end: socket.socket) -> bool:
        end.settimeout(_GREETING_S)
        if not _is_own(end) or not self._has_link_at(int(end.recv(8))):
            return False
        link = LocalLink(end)
        with self._lock:
            if len(self._links) >= _MOST_LINKS:
                return False
            self._links.add(link)
        end.settimeout(None)
        link.start(partial(self._receive, link), self._links.discard, "local calls")
        return bool(end.send(_YES))

    def close(self) -> None:
        """Accept no more links, and end those that there are."""
        self._forget()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        with self._lock:
            links = list(self._links)
        for link in links:
            link.close()


def _packet_socket() -> socket.socket:
    """Return a new packet socket; OSError if the system has no abstract names, or grants no such socket."""
    if not hasattr(socket, "SO_PEERCRED"):
        raise OSError("the sockets of this system have no abstract names")
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def _name(process: str) -> str:
    return f"\0eal-{PROTOCOL_VERSION}-{process}"


def _is_own(end: socket.socket) -> bool:
    """Return whether the process at the other end belongs to the same user."""
    credentials = end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize(_CREDENTIALS))
    _, user, _ = struct.unpack(_CREDENTIALS, credentials)
    return bool(user == os.geteuid())
