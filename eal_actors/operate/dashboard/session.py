"""BrowserSession: one browser's websocket. It executes messages and sends updates as fast as the browser reads."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import struct
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import AccessDeniedError, ArgumentError, BusyError, EALError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.throttled_log import ThrottledLog
from eal_actors.operate.audit import AuditLog
from eal_actors.operate.dashboard import messages
from eal_actors.operate.dashboard.access import Access, Role, Visitor
from eal_actors.operate.dashboard.browser_audit import BrowserAudit
from eal_actors.operate.dashboard.cameras import CameraKey, Cameras
from eal_actors.operate.dashboard.dispatcher import Dispatcher, Reply, failure
from eal_actors.operate.dashboard.limits import (
    COMMANDS_AT_ONCE,
    COMMANDS_PER_S,
    MAX_BROWSERS,
    MESSAGES_AT_ONCE,
    MESSAGES_PER_S,
    TokenBucket,
)
from eal_actors.operate.dashboard.notifier import Notifier
from eal_actors.operate.dashboard.places import place_of
from eal_actors.operate.dashboard.sign_in import SignIn
from eal_actors.operate.dashboard.state_store import StateReader, StateStore

HELLO_S: Final = 5.0
"""Real seconds within which a browser must send its first message."""
STUCK_S: Final = 10.0
"""Real seconds after which a browser that reads nothing is disconnected."""
MOST_ANSWERS: Final = 200
MOST_WAITING: Final = 8
"""The most requests of one browser that wait for its thread; a view asks for several lists at once."""
HEARTBEAT_S: Final = 1.0
"""The greatest real time between two updates: a page that receives none for longer shows that it is outdated."""
SEND_PERIOD_S: Final = 1 / 60
"""The least real time between two updates."""
POLICY_VIOLATION: Final = 1008
SIGN_IN: Final = 4401
"""The code of the closed websocket of a user whom the page must ask for a token."""
TRY_AGAIN_LATER: Final = 1013
_FREE: Final = (messages.StopAll, messages.DriveRobot, messages.ReleaseRobot, messages.Watch, messages.WatchValues)
"""They are limited by the number of messages alone; what to watch is limited where it is executed."""
_numbers = itertools.count(1)


class _FullError(BusyError):
    """All places for browsers are taken."""


@dataclass(frozen=True)
class AppState:
    """The application state, which all browsers of a dashboard share.

    `introduction` makes the first message to a browser, in the loop's thread. `report` finds the report of a run by
    its path. `refusals` limits the entries about refused users in the audit log, `strangers` the log lines about users
    who are not known.
    """

    store: StateStore
    notifier: Notifier
    access: Access
    sign_in: SignIn
    audit: AuditLog
    refusals: TokenBucket
    strangers: ThrottledLog
    dispatcher: Dispatcher
    cameras: Cameras
    clock: Clock
    introduction: Callable[[], Mapping[str, Any]]
    report: Callable[[str], Path | None]


class BrowserSession:
    """Serves one page, on a websocket that is not accepted yet. `admit` may refuse it. Thread: the loop's."""

    def __init__(self, websocket: WebSocket, app_state: AppState, admit: Callable[[BrowserSession], bool]) -> None:
        self.name: Final = f"browser {next(_numbers)}"
        self._websocket = websocket
        self._app_state = app_state
        self._admit = admit
        self._place = place_of(websocket.scope)
        self._visitor: Visitor | None = None
        self._audit: BrowserAudit | None = None
        self._event = app_state.notifier.subscribe()
        self._answers: deque[dict[str, Any]] = deque(maxlen=MOST_ANSWERS)
        self._cameras: tuple[CameraKey, ...] = ()
        self._frame_period_s = 0.2
        self._values_of: str | None = None
        self._chosen: dict[type, Any] = {}
        self._sent_s = 0.0
        self._frames: dict[CameraKey, tuple[int, float]] = {}
        self._messages = TokenBucket(MESSAGES_PER_S, MESSAGES_AT_ONCE)
        self._commands = TokenBucket(COMMANDS_PER_S, COMMANDS_AT_ONCE)
        self._waiting: deque[Any] = deque()
        self._file_task: asyncio.Task[None] | None = None
        self._dismissed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def serve(self) -> None:
        """Serve the page until it disconnects."""
        await self._websocket.accept()
        tasks: list[asyncio.Task[None]] = []
        try:
            await self._greet()
            tasks = [asyncio.create_task(self._receive_messages()), asyncio.create_task(self._send_updates())]
            done, _ = await asyncio.wait([*tasks, self._dismissed], return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except (WebSocketDisconnect, TimeoutError):
            pass
        except _FullError as error:
            await self._reject(error, TRY_AGAIN_LATER)
        except AccessDeniedError as error:
            await self._reject(error, SIGN_IN)
        except EALError as error:
            await self._reject(error, POLICY_VIOLATION)
        finally:
            ending = [*tasks, *([self._file_task] if self._file_task is not None else [])]
            for task in ending:  # first, or one would watch for a browser that has left
                task.cancel()
            self._app_state.notifier.unsubscribe(self._event)
            self._app_state.dispatcher.leave(self.name)
            if self._audit is not None:
                self._audit.close()
            for task in ending:
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, TimeoutError, EALError):
                    await task

    async def _greet(self) -> None:
        async with asyncio.timeout(HELLO_S):
            hello = messages.parse_message(await self._receive())
        if not isinstance(hello, messages.Hello):
            raise ArgumentError("the first message must be hello")
        self._visitor = visitor = await self._sign_in(hello.token)
        if not self._admit(self):
            raise _FullError(f"{MAX_BROWSERS} browsers are connected already")
        if self._place is not None:
            self._place.keep()
        rights = {"may_command": self.may_stop, "user": visitor.name, "role": visitor.role.name.lower()}
        fields = {"you": self.name, **rights, "why": visitor.refusal(Role.DRIVE)}
        await self._send_text({"hello": {**self._app_state.introduction(), **fields}})

    async def _sign_in(self, token: str | None) -> Visitor:
        """Find out who the user is; in a thread, because hashes take long."""
        address, place = self._address, self._place
        user = {"from": address, "browser": self.name}
        try:
            source = place.source if place is not None else address
            visitor = await asyncio.to_thread(self._app_state.sign_in.visitor, token, source)
        except AccessDeniedError as error:
            if token is not None and self._app_state.refusals.take(REAL_TIME.now()):
                self._app_state.audit.begin({"who": "unknown", **user}, "sign in", {})(f"refused: {error.message}")
            raise
        user = {"who": visitor.name, "role": visitor.role.name.lower(), **user}
        if visitor.is_proven:
            self._app_state.audit.begin(user, "sign in", {})("ok")
        self._audit = BrowserAudit(self._app_state.audit, user)
        return visitor

    @property
    def _address(self) -> str:
        client = self._websocket.client
        return client.host if client is not None else ""

    async def _reject(self, error: EALError, code: int) -> None:
        self._log_end(error.message)
        if self._websocket.application_state is WebSocketState.CONNECTED:
            with contextlib.suppress(TimeoutError, WebSocketDisconnect, RuntimeError):
                async with asyncio.timeout(STUCK_S):
                    await self._websocket.close(code, error.message[:100])

    def _log_end(self, reason: str) -> None:
        if self.may_stop:
            get_logger().warning("a browser was disconnected", browser=self.name, reason=reason)
        else:  # anybody, who could push out what operators must read
            self._app_state.strangers.warn(self._address, "a browser was disconnected", reason)

    @property
    def may_stop(self) -> bool:
        """Whether its user may stop the robots."""
        return self._visitor is not None and self._visitor.role >= Role.DRIVE

    def dismiss(self, operators: Collection[str]) -> None:
        """End the session if its user is one of these operators, or not known yet. The user may sign in again."""
        user = self._visitor
        if not self._dismissed.done() and (user is None or user.name in operators):
            self._dismissed.set_exception(AccessDeniedError("the operators have changed: sign in again"))
            self._dismissed.exception()  # it is read where it is waited for, if at all

    def abort(self) -> None:
        """Drop the connection: an orderly close would wait for the browser. It may connect again."""
        if self._place is not None:
            self._place.abort()

    # Incoming messages.

    async def _receive(self) -> str:
        message = await self._websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code") or 1000)
        text = message.get("text")
        if not isinstance(text, str):
            raise ArgumentError("messages must be text")
        return text

    async def _receive_messages(self) -> None:
        while True:
            text = await self._receive()
            if not self._messages.take(REAL_TIME.now()):
                raise BusyError("too many messages")
            message = messages.parse_message(text)
            if (refused := self._refusal(message)) is not None:
                self._refuse(message, refused)
            elif isinstance(message, messages.Watch | messages.WatchValues):
                self._chosen[type(message)] = message
                self._event.set()
            elif self._app_state.dispatcher.may_block(message):
                self._execute_in_thread(message)
            else:
                self._execute(message)

    def _watch_chosen(self) -> None:
        """Watch what the page chose last. A page that changes its choice too often waits; it does not lose the last."""
        for kind in list(self._chosen):
            if not self._commands.take(REAL_TIME.now()):
                return
            message = self._chosen.pop(kind)
            self._execute(message)
            if isinstance(message, messages.Watch):
                self._cameras, self._frame_period_s = message.cameras, 1 / message.rate_hz
            else:
                self._values_of = message.robot

    def _refusal(self, message: object) -> EALError | None:
        if isinstance(message, messages.Hello):
            return ArgumentError("hello must be the first message only")
        denied = self._visitor.refusal(messages.needed_role(message)) if self._visitor is not None else "sign in first"
        if denied is not None:
            return AccessDeniedError(denied)
        if not isinstance(message, _FREE) and not self._commands.take(REAL_TIME.now()):
            return BusyError("too many commands; wait a moment")
        return None

    def _refuse(self, message: Any, error: EALError) -> None:
        self.reply(failure(getattr(message, "id", None), error))
        if self._audit is None or messages.needed_role(message) is Role.WATCH:
            return
        if self._app_state.refusals.take(REAL_TIME.now()):  # strangers must not push commands out of the log
            self._audit.refuse(message, error.message)

    def _reply_to(self, message: Any) -> Reply:
        return self.reply if self._audit is None else self._audit.begin(message, self.reply)

    def _execute(self, message: Any) -> None:
        who = self._visitor.name if self._visitor is not None else self.name
        self._app_state.dispatcher.execute(message, self.name, who, self._reply_to(message))

    def _execute_in_thread(self, message: Any) -> None:
        """Execute a message that may block in a thread, after those before it, so that no stop is delayed."""
        if len(self._waiting) >= MOST_WAITING:
            self.reply(failure(message.id, BusyError("the previous requests are not finished")))
            return
        self._waiting.append(message)
        if self._file_task is None or self._file_task.done():
            self._file_task = asyncio.create_task(self._execute_waiting())

    async def _execute_waiting(self) -> None:
        while self._waiting:
            message = self._waiting.popleft()
            await asyncio.to_thread(self._execute, message)

    def reply(self, answer: dict[str, Any]) -> None:
        """Queue an answer; drops the oldest if the browser does not read them. Thread: any; does not block."""
        self._answers.append(answer)
        self._app_state.notifier.notify()

    # Outgoing messages.

    async def _send_updates(self) -> None:
        reader = StateReader(self._app_state.store)
        while True:
            self._watch_chosen()
            update = reader.take()
            values = update.pop("values", {})
            if self._values_of in values:  # only this browser's robot: others look at other ones
                update["values"] = {self._values_of: values[self._values_of]}
            answers = [self._answers.popleft() for _ in range(len(self._answers))]
            if answers:
                update["answers"] = answers
            if update or REAL_TIME.now() >= self._sent_s + HEARTBEAT_S:
                self._sent_s = REAL_TIME.now()
                await self._send_text({**update, "now_s": round(self._app_state.clock.now(), 3)})
            next_frame_s = await self._send_frames()
            await asyncio.sleep(SEND_PERIOD_S)
            if not reader.has_more:
                await self._wait_for_change(next_frame_s)

    async def _wait_for_change(self, at_most_s: float | None) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(HEARTBEAT_S if at_most_s is None else min(at_most_s, HEARTBEAT_S)):
                await self._event.wait()
        self._event.clear()

    async def _send_frames(self) -> float | None:
        """Send the frames that are due; return the seconds until the next available frame is due, or None."""
        waits = []
        for key in self._cameras:
            frame = self._app_state.cameras.frame(key)
            number, sent_s = self._frames.get(key, (-1, -1.0))
            if frame is None or frame.number in (number, 0):
                continue
            left_s = sent_s + self._frame_period_s - REAL_TIME.now()
            if left_s > SEND_PERIOD_S / 2:
                waits.append(left_s)
                continue
            self._frames[key] = (frame.number, REAL_TIME.now())
            about = {"stamp_s": frame.stamp_s, "same_since_s": frame.same_since_s, "error": frame.error}
            text = json.dumps({"robot": key[0], "resource": key[1], **about}).encode()
            await self._send(self._websocket.send_bytes, struct.pack("<I", len(text)) + text + frame.jpeg)
        return min(waits, default=None)

    async def _send_text(self, message: Mapping[str, Any]) -> None:
        await self._send(self._websocket.send_text, json.dumps(message, allow_nan=False, separators=(",", ":")))

    async def _send(self, send: Callable[[Any], Any], message: str | bytes) -> None:
        """Send a message. A browser that does not read it in time is disconnected; a live page reconnects."""
        try:
            async with asyncio.timeout(STUCK_S):
                await send(message)
        except TimeoutError:
            self._log_end("it stopped reading")
            self.abort()
            raise
