"""Values in memory that a robot's process and a controller's process on the same machine share.

A controller owns one piece of memory for each robot that sends it large values. It is an anonymous file of Linux
(memfd), which the robot opens as `/proc/<pid>/fd/<fd>`. So the kernel decides who may share: processes of the same
user (or root) that see each other's process ids. No name appears in /dev/shm, and the kernel frees the memory when the
last of both processes closes it or is killed.

Layout: a page with a random token and the states of the slots, then the slots. A state is 0 while the slot is free and
else the number of the value in it. The robot writes into free slots only, and only the controller frees a slot, once
nothing in its process refers to the value. So no value changes while it is read, and a robot that finds no free slot
sends the value over the link. A program that keeps many values gets copies. The file is sealed: nobody can shrink it,
which would kill the other process with SIGBUS.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import mmap
import os
import secrets
import stat
import threading
import weakref
from functools import lru_cache, partial
from pathlib import Path
from typing import Final, NamedTuple, Self

from typing_extensions import override

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import ProtocolError, UnavailableError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.posix import fcntl

LEAST_BYTES: Final = 64 * 1024
"""Length from which a value is handed over in shared memory; a shorter one takes as long over a link."""
MOST_BYTES: Final = 8 * 1024**2
"""Length of the largest slot."""

_MOST_MEMORIES: Final = 16
"""Limit of the controllers that share memory with one robot; others receive their values over their links."""
_CHECK_S: Final = 1.0
_SLOTS: Final = 4
_SPARE_SLOTS: Final = 2
"""Slots that values in use leave free."""
_MOST_SLOTS: Final = 64
_PAGE: Final = mmap.PAGESIZE
_TOKEN_BYTES: Final = 16
_FIRST_STATE: Final = _TOKEN_BYTES // 8
_FREE: Final = 0
_UNUSED: Final = 2**64 - 1
"""State of a slot whose memory is not yet allocated."""


class MemoryOffer(NamedTuple):
    """Arguments of the method `memory`: where a controller's memory is.

    Attributes:
        pid: the controller's process, by its own process namespace, in which `fd` is the descriptor.
        inode: number of the file, which identifies the memory in messages too.
        token: content of its first bytes, as hexadecimal digits: proof that it is this controller's.
        slot_bytes: length of each slot, a whole number of pages.
    """

    pid: int
    fd: int
    inode: int
    token: str
    slots: int
    slot_bytes: int

    @classmethod
    def parse(cls, arguments: tuple[object, ...]) -> Self:
        """Return the offer; ProtocolError if the arguments are none."""
        if tuple(map(type, arguments)) != (int, int, int, str, int, int):
            raise ProtocolError(f"memory does not take the arguments {arguments!r}")
        offer = cls(*arguments)  # type: ignore[arg-type]  # checked above
        is_sound = (
            0 < offer.slots <= _MOST_SLOTS and 0 < offer.slot_bytes <= MOST_BYTES and not offer.slot_bytes % _PAGE
        )
        if not is_sound or offer.pid <= 0 or offer.fd < 0 or len(offer.token) != 2 * _TOKEN_BYTES:
            raise ProtocolError(f"memory: {arguments!r} is no offer")
        return offer

    @property
    def size(self) -> int:
        """Length of the file."""
        return _PAGE + self.slots * self.slot_bytes


class SharedValue(NamedTuple):
    """Place of a value in shared memory; `number` is the state of the slot while it holds the value."""

    inode: int
    slot: int
    number: int
    length: int


@lru_cache(maxsize=16)
def _array_type(length: int) -> type[ctypes.Array[ctypes.c_ubyte]]:
    return ctypes.c_ubyte * length  # making a type takes longer than all else


class _SharedMemory:
    """One end of a mapped memory. Thread: any; with the lock, after a look whether it is still open."""

    def __init__(self, fd: int, offer: MemoryOffer) -> None:
        self._lock = threading.Lock()
        self._is_open = True
        self._map = mmap.mmap(fd, offer.size)
        self._content = memoryview(self._map)
        self._states = self._content[:_PAGE].cast("Q")[_FIRST_STATE : _FIRST_STATE + offer.slots]

    def close(self) -> None:
        """Close this end. The robot's follows the controller's within a second."""
        with self._lock:
            self._is_open = False
            self._states.release()
            self._content.release()
            with contextlib.suppress(BufferError):  # the last value in use closes it
                self._map.close()


class OwnedMemory(_SharedMemory):
    """The controller's end: reads values of up to `value_bytes` and frees their slots. Thread: any.

    Raises OSError if the kernel gives no memory, or this is not Linux.
    """

    def __init__(self, value_bytes: int) -> None:
        if not hasattr(os, "memfd_create"):
            raise OSError("this system has no memfd_create")
        slot_bytes = -(-value_bytes // _PAGE) * _PAGE
        self._taken: dict[int, object] = {}  # values in use, by their numbers
        fd = os.memfd_create("eal-values", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        self._file = io.FileIO(fd, "r+")
        try:
            token = secrets.token_bytes(_TOKEN_BYTES)
            self.offer: Final = MemoryOffer(os.getpid(), fd, os.fstat(fd).st_ino, token.hex(), _SLOTS, slot_bytes)
            os.ftruncate(fd, self.offer.size)
            fcntl.fcntl(fd, fcntl.F_ADD_SEALS, _SEALS)
            super().__init__(fd, self.offer)
        except OSError:
            self._file.close()
            raise
        self._content[:_TOKEN_BYTES] = token
        for slot in range(_SLOTS):
            self._states[slot] = _UNUSED

    def allocate(self) -> None:
        """Allocate the slots, which the robot may then use; OSError if the kernel has no memory left."""
        with self._lock:
            if self._is_open:
                os.posix_fallocate(self._file.fileno(), 0, self.offer.size)
                for slot in range(_SLOTS):
                    self._states[slot] = _FREE

    def take(self, value: SharedValue) -> Payload:
        """Return a value, which keeps its slot while it is in use; a copy if few slots are free.

        Raises ProtocolError if there is no such slot, and UnavailableError if the value is no longer there.
        """
        offer = self.offer
        if value.slot >= offer.slots or value.length > offer.slot_bytes:
            raise ProtocolError(
                f"shared memory: {value!r} is no place in {offer.slots} slots of {offer.slot_bytes} bytes"
            )
        start = _PAGE + value.slot * offer.slot_bytes
        with self._lock:
            if not self._is_open or self._states[value.slot] != value.number or value.number in self._taken:
                raise UnavailableError("a value is no longer in shared memory; read it again")
            if list(self._states).count(_FREE) >= _SPARE_SLOTS:
                part = _array_type(value.length).from_buffer(self._map, start)  # it lives while anything refers to it
                self._taken[value.number] = weakref.ref(part, partial(self._free, value))
                return memoryview(part).cast("B").toreadonly()
            copy = bytes(self._content[start : start + value.length])
            self._states[value.slot] = _FREE
        return copy

    def _free(self, value: SharedValue, _: object) -> None:
        """Free the slot of a value that is no longer in use. Thread: any; it may hold the lock, so this takes none."""
        self._taken.pop(value.number, None)
        with contextlib.suppress(ValueError):  # the memory is closed
            self._states[value.slot] = _FREE

    @override
    def close(self) -> None:
        super().close()
        self._file.close()


_SEALS: Final = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL if hasattr(fcntl, "F_SEAL_SHRINK") else 0


class PeerMemory(_SharedMemory):
    """The robot's end: writes values into free slots. Thread: any.

    Raises OSError if this process may not open it, or it is that of another machine or another process namespace.
    """

    def __init__(self, offer: MemoryOffer) -> None:
        self._offer = offer
        self._last = 0
        self._place = Path("/proc") / str(offer.pid) / "fd" / str(offer.fd)
        if not self.is_offered:  # opening some other file could have an effect, such as on a tape or a pipe
            raise FileNotFoundError(f"{self._place} is not the offered memory")
        fd = os.open(self._place, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            if fcntl.fcntl(fd, fcntl.F_GET_SEALS) != _SEALS or os.fstat(fd).st_size != offer.size:
                raise FileNotFoundError(f"{self._place} is not sealed at {offer.size} bytes")
            if os.pread(fd, _TOKEN_BYTES, 0).hex() != offer.token:
                raise FileNotFoundError(f"{self._place} does not contain the token")
            super().__init__(fd, offer)
        finally:
            os.close(fd)

    @property
    def is_offered(self) -> bool:
        """Whether the controller's process still has the memory open."""
        try:
            found = self._place.stat()
        except OSError:
            return False
        return stat.S_ISREG(found.st_mode) and found.st_ino == self._offer.inode

    def put(self, payload: Payload) -> SharedValue | None:
        """Write a value; returns None if no slot is free or the value is too long."""
        offer, length = self._offer, memoryview(payload).nbytes
        if length > offer.slot_bytes:
            return None
        with self._lock:
            for slot in range(offer.slots) if self._is_open else ():
                if self._states[slot] == _FREE:
                    start = _PAGE + slot * offer.slot_bytes
                    self._content[start : start + length] = payload
                    self._last += 1
                    self._states[slot] = self._last
                    return SharedValue(offer.inode, slot, self._last, length)
        return None


class ControllerMemories:
    """Memory of one robot's controllers by their client identifiers, if the fleet file enables it. Thread: any.

    No value depends on it: where memory cannot be opened, or has no free slot, the value goes over the link. A
    controller has one memory here at most, their number is limited, and one that its controller no longer has open is
    closed. So controllers that are killed or offer memory again do not use up the robot's.
    """

    def __init__(self, robot: str, *, is_enabled: bool) -> None:
        self._is_enabled = is_enabled
        self._lock = threading.Lock()
        self._memories: dict[str, PeerMemory] = {}
        self._next_check_s = 0.0
        self._log = get_logger(robot=robot)

    def open(self, client: str, arguments: tuple[object, ...]) -> bool:
        """Open the memory that a controller offers, in place of its earlier one; ProtocolError if that is no offer.

        Returns whether it could be opened.
        """
        offer = MemoryOffer.parse(arguments)
        with self._lock:
            if not self._is_enabled or (len(self._memories) >= _MOST_MEMORIES and client not in self._memories):
                return False
            try:
                memory = PeerMemory(offer)
            except (OSError, ValueError) as error:  # another machine, another user, another process namespace
                self._log.debug("no memory is shared with a controller", client=client, reason=error_text(error))
                return False
            former = self._memories.get(client)
            self._memories[client] = memory
        if former is not None:
            former.close()
        return True

    def put(self, client: str, payload: Payload) -> SharedValue | None:
        """Hand a value to a controller; returns None if it must be sent over the link."""
        memory = self._memories.get(client)
        return None if memory is None or memoryview(payload).nbytes < LEAST_BYTES else memory.put(payload)

    def check(self) -> None:
        """Close memory that its controller has closed, once a second."""
        if self._memories and REAL_TIME.now() >= self._next_check_s:
            self._next_check_s = REAL_TIME.now() + _CHECK_S
            with self._lock:
                ended = [client for client, memory in self._memories.items() if not memory.is_offered]
                memories = [self._memories.pop(client) for client in ended]
            for memory in memories:
                memory.close()

    def close(self) -> None:
        """Close all memory."""
        with self._lock:
            self._is_enabled = False
            memories = list(self._memories.values())
            self._memories.clear()
        for memory in memories:
            memory.close()
