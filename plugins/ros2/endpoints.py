"""The endpoints of a ROS 2 node: publisher, subscription, service client and service server."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import zenoh
from zenoh import handlers
from zenoh.ext import HistoryConfig, declare_advanced_subscriber

from eal_actors.plugin import Activity, DataError, EALError, ResourceFaultError, UnavailableError, get_logger

from .graph import Attachment
from .message_types import MessageType, ServiceType

Require: TypeAlias = Callable[[], zenoh.Session]
"""Returns the open session, or raises UnavailableError."""

_CDR: Final = zenoh.Encoding("application/cdr")
_POLL_S: Final = 0.01


class RosPublisher:
    """Publishes one topic; its messages carry their number, their time and the publisher's id."""

    def __init__(self, require: Require, key: str, kind: MessageType, gid: bytes) -> None:
        self._require = require
        self._key = key
        self._kind = kind
        self._gid = gid
        self._lock = threading.Lock()
        self._sequence = 0
        self._publisher: zenoh.Publisher | None = None

    def declare(self, session: zenoh.Session) -> None:
        """Declare it in an open session."""
        self._publisher = session.declare_publisher(
            self._key, encoding=_CDR, congestion_control=zenoh.CongestionControl.DROP
        )

    def publish(self, fields: Mapping[str, Any]) -> None:
        """Publish a message of these fields; see MessageType.encode.

        Raises:
            ArgumentError: they do not fit the type.
            UnavailableError: the router is out of reach.

        Thread: any; does not block: a message that does not fit into a full link is dropped.
        """
        data = self._kind.encode(fields)
        self._require()
        with self._lock:
            if self._publisher is None:
                raise UnavailableError(f"{self._key} is not declared yet")
            self._sequence += 1
            attachment = Attachment(self._sequence, time.time_ns(), self._gid).pack()
            try:
                self._publisher.put(data, attachment=attachment)
            except zenoh.ZError as error:
                raise UnavailableError(f"{self._key} could not be sent: {error}") from error


@dataclass(frozen=True, slots=True)
class Received:
    """A message as it arrived.

    Attributes:
        sent_ns: when its publisher sent it, by its clock in nanoseconds since 1970; None if it does not say.
    """

    message: Any
    sent_ns: int | None


class RosSubscription:
    """Keeps the newest messages of one topic until they are taken.

    Attributes:
        topic: the fully qualified name.
    """

    def __init__(
        self, topic: str, key: str, kind: MessageType, depth: int, max_bytes: int, *, is_latched: bool
    ) -> None:
        self.topic: Final = topic
        self.kind: Final = kind
        self._key = key
        self._depth = depth
        self._max_bytes = max_bytes
        self._is_latched = is_latched
        self._subscriber: Any = None

    def declare(self, session: zenoh.Session) -> None:
        """Declare it in an open session; a latched topic sends its last messages."""
        ring: Any = handlers.RingChannel(self._depth)
        if self._is_latched:
            history = HistoryConfig(detect_late_publishers=True)
            self._subscriber = declare_advanced_subscriber(session, self._key, ring, history=history)
        else:
            self._subscriber = session.declare_subscriber(self._key, ring)

    def take(self) -> Received | None:
        """Return the oldest message that is kept; None if there is none.

        Raises:
            DataError: it is too long, or no message of the type.

        Thread: any; does not block.
        """
        if self._subscriber is None:
            return None
        try:
            sample = self._subscriber.try_recv()
        except zenoh.ZError:  # the session is closed
            return None
        if sample is None:
            return None
        if len(sample.payload) > self._max_bytes:
            raise DataError(f"{self.topic}: a message of {len(sample.payload)} bytes; max_bytes is {self._max_bytes}")
        return Received(self.kind.decode(sample.payload.to_bytes()), _sent_ns(sample))


def _sent_ns(sample: zenoh.Sample) -> int | None:
    if sample.attachment is None:
        return None
    try:
        return Attachment.unpack(sample.attachment.to_bytes()).stamp_ns
    except DataError:
        return None


class RosClient:
    """Calls one service."""

    def __init__(self, require: Require, name: str, key: str, kind: ServiceType, gid: bytes) -> None:
        self._require = require
        self.name: Final = name
        self.kind: Final = kind
        self._key = key
        self._gid = gid
        self._lock = threading.Lock()
        self._sequence = 0

    def ask(self, fields: Mapping[str, Any], timeout_s: float) -> handlers.Handler[zenoh.Reply]:
        """Send a request; returns the channel of its answer.

        Raises:
            ArgumentError: the fields do not fit the type.
            UnavailableError: the router is out of reach.
        """
        data = self.kind.request.encode(fields)
        session = self._require()
        with self._lock:
            self._sequence += 1
            attachment = Attachment(self._sequence, time.time_ns(), self._gid).pack()
        try:
            return session.get(
                self._key,
                handlers.FifoChannel(4),
                payload=data,
                encoding=_CDR,
                attachment=attachment,
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s,
            )
        except zenoh.ZError as error:
            raise UnavailableError(f"the request to {self.name} could not be sent: {error}") from error

    def call(self, fields: Mapping[str, Any], timeout_s: float) -> Activity:
        """Call the service; an activity that returns the response's message.

        Raises:
            ArgumentError: the fields do not fit the type.
            UnavailableError: there is no answer in time.
            ResourceFaultError: the service answers with an error.
        """
        channel = self.ask(fields, timeout_s)
        while (answer := self.poll(channel)) is None:
            yield _POLL_S
        return answer

    def poll(self, channel: handlers.Handler[zenoh.Reply]) -> Any:
        """Return the answer in a channel; None if it has not arrived. Raises what `call` raises."""
        try:
            reply = channel.try_recv()
        except zenoh.ZError:  # the engine ends the channel after the time-out, or when nobody serves
            raise UnavailableError(f"{self.name} did not answer") from None
        if reply is None:
            return None
        if reply.ok is None:
            text = b"" if reply.err is None else reply.err.payload.to_bytes()
            raise ResourceFaultError(f"{self.name} failed: {text.decode(errors='replace')[:200]}")
        return self.kind.response.decode(reply.ok.payload.to_bytes())


class RosService:
    """Serves one service."""

    def __init__(self, key: str, kind: ServiceType, answer: Callable[[Any], dict[str, Any]]) -> None:
        self._key = key
        self._kind = kind
        self._answer = answer
        self._queryable: Any = None

    def declare(self, session: zenoh.Session) -> None:
        """Declare it in an open session."""
        callback = handlers.Callback(self._serve, indirect=False)
        self._queryable = session.declare_queryable(self._key, callback, complete=True)

    def _serve(self, query: zenoh.Query) -> None:
        """Answer one request. Thread: the engine's."""
        with query:
            try:
                if query.payload is None or query.attachment is None:
                    raise DataError("a request needs a payload and an attachment")
                asked = Attachment.unpack(query.attachment.to_bytes())
                response = self._answer(self._kind.request.decode(query.payload.to_bytes()))
                data = self._kind.response.encode(response)
            except EALError as error:
                query.reply_err(error.message)
                return
            except Exception as error:  # noqa: BLE001  # without an answer, the caller would wait for its time-out
                get_logger(service=self._key).exception("a request was not answered")
                query.reply_err(str(error))
                return
            attachment = Attachment(asked.sequence, time.time_ns(), asked.gid).pack()
            query.reply(self._key, data, encoding=_CDR, attachment=attachment)
