"""One browser at the other end of a websocket: what it says is done, and it gets the news as fast as it reads."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import AccessDeniedError, ArgumentError, BusyError, EALError
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.access import Access
from eal_actors.operate.dashboard.bell import Bell
from eal_actors.operate.dashboard.cameras import CameraKey, Cameras
from eal_actors.operate.dashboard.commander import Commander, failure
from eal_actors.operate.dashboard.hub import Hub, Reader
from eal_actors.operate.dashboard.limits import (
    COMMANDS_AT_ONCE,
    COMMANDS_PER_S,
    MESSAGES_AT_ONCE,
    MESSAGES_PER_S,
    Allowance,
)
from eal_actors.operate.dashboard.messages import COMMANDS, Drive, Hello, LetGo, Stop, Watch, parse_message

HELLO_S: Final = 5.0
"""Real seconds within which a browser must say who it is."""
STUCK_S: Final = 10.0
"""Real seconds after which a browser that reads nothing is cut off."""
MOST_ANSWERS: Final = 200
SEND_PERIOD_S: Final = 1 / 60
"""The least real time between two messages of news."""
POLICY_VIOLATION: Final = 1008
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Backstage:
    """What all browsers of a dashboard share.

    Attributes:
        hub: the state.
        bell: rings when something is new.
        access: who may command.
        commander: carries out what they say.
        cameras: their frames.
        clock: the fleet's clock.
        introduction: makes what a browser must know first, in the loop's thread.
        report: finds the report page of a run by the name of its folder.
    """

    hub: Hub
    bell: Bell
    access: Access
    commander: Commander
    cameras: Cameras
    clock: Clock
    introduction: Callable[[], Mapping[str, Any]]
    report: Callable[[str], Path | None]


class Browser:
    """Speaks with one page, from its first word to its last. Thread: the loop's.

    Args:
        websocket: the connection, not accepted yet.
        backstage: what it has in common with others.
    """

    def __init__(self, websocket: WebSocket, backstage: Backstage) -> None:
        self.name: Final = f"browser {next(_numbers)}"
        self._websocket = websocket
        self._backstage = backstage
        self._may_not: str | None = "say hello first"
        self._event = backstage.bell.listen()
        self._answers: deque[dict[str, Any]] = deque(maxlen=MOST_ANSWERS)
        self._cameras: tuple[CameraKey, ...] = ()
        self._frame_period_s = 0.2
        self._frames: dict[CameraKey, tuple[int, float]] = {}
        self._messages = Allowance(MESSAGES_PER_S, MESSAGES_AT_ONCE)
        self._commands = Allowance(COMMANDS_PER_S, COMMANDS_AT_ONCE)
        self._errand: asyncio.Task[None] | None = None

    async def serve(self) -> None:
        """Speak with it until it goes."""
        await self._websocket.accept()
        tasks: list[asyncio.Task[None]] = []
        try:
            await self._greet()
            tasks = [asyncio.create_task(self._listen()), asyncio.create_task(self._tell())]
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except (WebSocketDisconnect, TimeoutError):
            pass
        except EALError as error:
            await self._turn_away(error)
        finally:
            self._backstage.bell.leave(self._event)
            self._backstage.commander.leave(self.name)
            for task in [*tasks, *([self._errand] if self._errand is not None else [])]:
                task.cancel()
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, TimeoutError, EALError):
                    await task

    async def _greet(self) -> None:
        async with asyncio.timeout(HELLO_S):
            hello = parse_message(await self._heard())
        if not isinstance(hello, Hello):
            raise ArgumentError("say hello first")
        self._may_not = self._backstage.access.refusal(hello.token)
        rights = {"you": self.name, "may_command": self._may_not is None, "why": self._may_not}
        introduction = {**self._backstage.introduction(), **rights}
        await self._send_text({"hello": introduction})

    async def _turn_away(self, error: EALError) -> None:
        get_logger().warning("a browser was turned away", browser=self.name, reason=error.message)
        if self._websocket.application_state is WebSocketState.CONNECTED:
            with contextlib.suppress(TimeoutError, WebSocketDisconnect, RuntimeError):
                async with asyncio.timeout(STUCK_S):
                    await self._websocket.close(POLICY_VIOLATION, error.message[:100])

    # What it says.

    async def _heard(self) -> str:
        message = await self._websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code") or 1000)
        text = message.get("text")
        if not isinstance(text, str):
            raise ArgumentError("messages are text")
        return text

    async def _listen(self) -> None:
        while True:
            text = await self._heard()
            if not self._messages.take(REAL_TIME.now()):
                raise BusyError("too many messages")
            message = parse_message(text)
            refused = self._refusal(message)
            if refused is not None:
                self.reply(failure(getattr(message, "id", None), refused))
            elif self._backstage.commander.reads_files(message):
                self._send_on_errand(message)
            else:
                self._backstage.commander.carry_out(message, self.name, self.reply)
                if isinstance(message, Watch):
                    self._cameras, self._frame_period_s = message.cameras, 1 / message.rate_hz

    def _refusal(self, message: object) -> EALError | None:
        if isinstance(message, Hello):
            return ArgumentError("hello was said already")
        if isinstance(message, COMMANDS) and self._may_not is not None:
            return AccessDeniedError(self._may_not)
        is_free = isinstance(message, Stop | Drive | LetGo)  # of which only the number of messages limits how many
        if not is_free and not self._commands.take(REAL_TIME.now()):
            return BusyError("too many commands; wait a moment")
        return None

    def _send_on_errand(self, message: Any) -> None:
        """Have a thread do what may block, so that a stop that comes next is heard at once."""
        if self._errand is not None and not self._errand.done():
            self.reply(failure(message.id, BusyError("the last request is still being worked on")))
            return
        work = asyncio.to_thread(self._backstage.commander.carry_out, message, self.name, self.reply)
        self._errand = asyncio.create_task(work)

    def reply(self, answer: dict[str, Any]) -> None:
        """Tell it something, or drop the oldest of what it does not read. Thread: any; does not block."""
        self._answers.append(answer)
        self._backstage.bell.ring()

    # What it is told.

    async def _tell(self) -> None:
        reader = Reader(self._backstage.hub)
        while True:
            news = reader.take()
            answers = [self._answers.popleft() for _ in range(len(self._answers))]
            if answers:
                news["answers"] = answers
            if news:
                await self._send_text({**news, "now_s": round(self._backstage.clock.now(), 3)})
            next_frame_s = await self._send_frames()
            await asyncio.sleep(SEND_PERIOD_S)
            if not reader.has_more:
                await self._next_ring(next_frame_s)

    async def _next_ring(self, at_most_s: float | None) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(at_most_s):
                await self._event.wait()
        self._event.clear()

    async def _send_frames(self) -> float | None:
        """Send the frames that are due; return the seconds until the next one that is there already, or None."""
        waits = []
        for key in self._cameras:
            frame = self._backstage.cameras.frame(key)
            number, sent_s = self._frames.get(key, (-1, -1.0))
            if frame is None or frame.number in (number, 0):
                continue
            left_s = sent_s + self._frame_period_s - REAL_TIME.now()
            if left_s > SEND_PERIOD_S / 2:
                waits.append(left_s)
                continue
            self._frames[key] = (frame.number, REAL_TIME.now())
            header = {
                "robot": key[0],
                "resource": key[1],
                "stamp_s": frame.stamp_s,
                "same_since_s": frame.same_since_s,
                "error": frame.error,
            }
            text = json.dumps(header).encode()
            await self._send(self._websocket.send_bytes, struct.pack("<I", len(text)) + text + frame.jpeg)
        return min(waits, default=None)

    async def _send_text(self, message: Mapping[str, Any]) -> None:
        await self._send(self._websocket.send_text, json.dumps(message, allow_nan=False, separators=(",", ":")))

    async def _send(self, send: Callable[[Any], Any], message: str | bytes) -> None:
        """Send something; a browser that has read nothing for long is cut off, and comes again if it lives."""
        try:
            async with asyncio.timeout(STUCK_S):
                await send(message)
        except TimeoutError:
            get_logger().warning("a browser that stopped reading was cut off", browser=self.name)
            abort = self._websocket.scope.get("state", {}).get("abort")
            if abort is not None:
                abort()
            raise
