"""The least program that keeps what this project promises of a reading and a command, for the last rows of the floor.

It knows one robot with one resource and one controller, and has no configuration, streams, traces, batches, security
or recovery. It keeps: typed values with times, an end of each call by its deadline, one outcome for each, bounded
mailboxes, a thread for the resource, no late call; and of commands, fresh and accepted once (stamp, history), one
commander (lease), a watch over its silence (dead-man's switch), and kept outcomes. The fields of the messages are this
project's. What it does is written out in as few functions as Python allows.
"""

from __future__ import annotations

import itertools
import math
import queue
import struct
import threading
from collections import OrderedDict, deque
from typing import Any, Final, Protocol

import msgpack

from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire.format.packing import data_from, data_header
from eal_actors.wire.shared_memory import OwnedMemory, PeerMemory, SharedValue
from tests.benchmarks.network_host import FRAME

MOST, TIMEOUT_S, TTL_S, DEAD_MAN_S, DRIFT = 256, 5.0, 1.0, 2.0, 500e-6
VERSION, ERA, CLIENT = 3, "0123abcd", bytes(16)
_READING: Final = [int, bytes, int, int, float, float, type(None), list, type(None)]
_COMMAND: Final = [*_READING, str, float, float]
_REPLIES: Final = [int, int, int, list, str, float], [int, int, int, int, str, float]
STATUS, VALUE, ERROR = range(3)
_PLACE: Final = struct.Struct("4Q")
"""A SharedValue."""


class Publisher(Protocol):
    """Sends messages with one key."""

    def put(self, payload: bytes, *, attachment: bytes) -> None:
        """Send one."""


class LeastRobot:
    """The robot's end.

    Args:
        answers: publishes the replies.
        memory: takes the value, which is a frame then.
    """

    def __init__(self, answers: Publisher, memory: PeerMemory | None = None) -> None:
        self._answers, self._memory = answers, memory
        self._lock, self._wakes, self._waits = threading.Lock(), threading.Lock(), False
        self._wakes.acquire()
        self._mailbox: deque[tuple[int, bytes, float, float, list[Any]]] = deque()
        self._guard = threading.Lock()
        self._latest: dict[bytes, tuple[int, int]] = {}
        self._running: set[tuple[bytes, int]] = set()
        self._outcomes: OrderedDict[tuple[bytes, int], int] = OrderedDict()
        self._lease = b"", -math.inf
        self.watched = b"", -math.inf
        self.busy_until_s: float | None = None
        self._putting = threading.Lock()
        self._left: queue.SimpleQueue[tuple[bytes, bytes]] = queue.SimpleQueue()
        threading.Thread(target=self._work, daemon=True).start()

    def receive(self, key: str, envelope: bytes, payload: bytes) -> None:
        """Check a call and put it into the mailbox."""
        row = msgpack.unpackb(envelope, max_array_len=MOST, max_ext_len=0)
        kinds = list(map(type, row))
        if kinds not in (_READING, _COMMAND) or payload or not key.endswith("0"):
            raise ValueError(row)
        version, client, epoch, number, ttl_s, left_s, _, arguments, _, *stamp = row
        if version != VERSION or epoch < 0 or number < 0 or len(client) != len(CLIENT) or left_s <= 0:
            self._refuse(number, "the call is malformed or late")
            return
        now_s = REAL_TIME.now()
        deadline_s, begin_by_s = now_s + left_s, now_s + left_s
        if stamp:
            era, echo_s, held_s = stamp
            sent_s = echo_s + held_s * (1 - DRIFT)
            with self._guard:
                holder, heard_s = self._lease
                if (
                    era != ERA
                    or not -0.001 <= now_s - sent_s <= ttl_s
                    or (epoch, number) <= self._latest.get(client, ())
                ):
                    self._refuse(number, "the command is stale")
                    return
                self._latest[client] = epoch, number
                if holder != client and now_s < heard_s + DEAD_MAN_S:
                    self._refuse(number, "another controller holds it")
                    return
                self._running.add((client, number))
                self._lease = self.watched = client, now_s
            deadline_s, begin_by_s = sent_s + left_s, sent_s + ttl_s
        with self._lock:
            if len(self._mailbox) >= MOST:
                self._refuse(number, "the mailbox is full")
                return
            self._mailbox.append((number, client, deadline_s, begin_by_s, arguments))
            if self._waits:
                self._waits = False
                self._wakes.release()

    def _work(self) -> None:
        while True:
            with self._lock:
                call = self._mailbox.popleft() if self._mailbox else None
                self._waits = call is None
            if call is None:
                self._wakes.acquire()
                continue
            number, client, deadline_s, begin_by_s, arguments = call
            if REAL_TIME.now() > min(deadline_s, begin_by_s):
                self._refuse(number, "the call waited too long")
                continue
            self.busy_until_s = deadline_s
            try:
                answer = self.command(*arguments) if arguments else self.value()
            except Exception as error:  # noqa: BLE001  # as a plugin may raise anything
                self._refuse(number, str(error))
                continue
            finally:
                self.busy_until_s = None
            if arguments:
                with self._guard:
                    self._running.discard((client, number))
                    self._outcomes[client, number] = 1
                    if len(self._outcomes) > 4 * MOST:
                        self._outcomes.popitem(last=False)
            self._reply(number, answer)

    def value(self) -> EALData:
        """Return the resource's value."""
        return EALData.of(FRAME if self._memory is not None else 1.0, stamp_s=0.0)

    def command(self, text: str) -> int:
        """Carry out a command."""
        if text != "on":
            raise ValueError(text)
        return 1

    def _reply(self, number: int, answer: EALData | int) -> None:
        if type(answer) is EALData:
            fields = VERSION, number, VALUE, data_header(answer), ERA, REAL_TIME.now()
            if self._memory is not None and (place := self._memory.put(answer.payload)) is not None:
                self._send(msgpack.packb(fields), _PLACE.pack(*place))
            else:
                self._send(msgpack.packb(fields), bytes(answer.payload))
        else:
            self._send(msgpack.packb((VERSION, number, STATUS, answer, ERA, REAL_TIME.now())), b"")

    def _refuse(self, number: int, why: str) -> None:
        self._send(msgpack.packb((VERSION, number, ERROR, [why], ERA, REAL_TIME.now())), b"")

    def _send(self, envelope: bytes, payload: bytes) -> None:
        if not self._putting.acquire(blocking=False):
            self._left.put((envelope, payload))  # for a thread of its own, which this measurement never needs
            return
        try:
            self._answers.put(payload, attachment=envelope)
        finally:
            self._putting.release()


class _Call:
    """A call: its outcome, the first of several."""

    __slots__ = ("deadline_s", "is_done", "lock", "outcome", "waiter")

    def __init__(self, deadline_s: float) -> None:
        self.deadline_s = deadline_s
        self.lock = threading.Lock()
        self.is_done = False
        self.outcome: Any = None
        self.waiter: Any = None

    def settle(self, outcome: object) -> None:
        """Set the outcome unless there is one."""
        with self.lock:
            if self.is_done:
                return
            self.outcome, self.is_done = outcome, True
        if self.waiter is not None:
            self.waiter.release()

    def get(self) -> Any:
        """Wait for the outcome until the deadline; the main thread handles signals meanwhile."""
        waiter = threading.Lock()
        waiter.acquire()
        with self.lock:
            if not self.is_done:
                self.waiter = waiter
        while not self.is_done:
            left_s = self.deadline_s - REAL_TIME.now()
            if left_s <= 0:
                self.settle(TimeoutError("no answer"))
            waiter.acquire(timeout=min(max(left_s, 0.0), 0.2))
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome


class LeastController:
    """The controller's end.

    Args:
        readings: publishes readings.
        commands: publishes commands.
        memory: where values of the size of a frame are.
    """

    def __init__(self, readings: Publisher, commands: Publisher, memory: OwnedMemory | None = None) -> None:
        self.memory = memory
        self._put = readings.put, commands.put
        self._numbers = itertools.count(1)
        self._lock, self._sending = threading.Lock(), threading.Lock()
        self._unanswered: set[_Call] = set()
        self._pending: dict[int, _Call] = {}
        self._echo = ERA, 0.0, 0.0
        self.offset_s = 0.0

    def read(self) -> Any:
        """Return the value."""
        return self.start([], is_command=False).get()

    def command(self) -> Any:
        """Have the command carried out."""
        return self.start(["on"], is_command=True).get()

    def start(self, arguments: list[str], *, is_command: bool) -> _Call:
        call = _Call(REAL_TIME.now() + TIMEOUT_S)
        with self._lock:
            if len(self._unanswered) >= MOST:
                call.settle(BlockingIOError("too many calls"))
                return call
            self._unanswered.add(call)
        with self._sending:  # a caller at a time: this program has no queue
            number, now_s = next(self._numbers), REAL_TIME.now()
            left_s = call.deadline_s - now_s
            row = [VERSION, CLIENT, 0, number, TTL_S if is_command else left_s, left_s, None, arguments, None]
            if is_command:
                era, echo_s, came_s = self._echo
                row += era, echo_s, now_s - came_s
            self._pending[number] = call
            self._put[is_command](b"", attachment=msgpack.packb(row))
        return call

    def receive(self, key: str, envelope: bytes, payload: bytes) -> None:
        """Settle the call that a reply belongs to."""
        if "bot" not in key:
            raise ValueError(key)
        row = msgpack.unpackb(envelope, max_array_len=MOST, max_ext_len=0)
        if list(map(type, row)) not in _REPLIES or row[0] != VERSION:
            raise ValueError(row)
        _, number, kind, body, era, time_s = row
        now_s = REAL_TIME.now()
        self._echo = era, time_s, now_s
        call = self._pending.pop(number, None)
        if call is None:
            return
        answer: Any = body
        if kind == VALUE:
            content: Any = payload
            if self.memory is not None and len(payload) == _PLACE.size:
                content = self.memory.take(SharedValue(*_PLACE.unpack(payload)))
            answer = data_from(body, content, "answer")
            if (stamp_s := answer.stamp_s) is not None:
                answer.restamp(min(now_s, time_s - self.offset_s) - time_s + stamp_s)
        elif kind == ERROR:
            answer = RuntimeError(*body)
        self._unanswered.discard(call)
        call.settle(answer)
