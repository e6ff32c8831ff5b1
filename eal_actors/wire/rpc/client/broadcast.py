"""A request to many robots at once, such as an emergency stop: no handshake, and absent robots delay no others.

A message may be lost with a link, so a robot is asked again until it answers; methods must be idempotent. Each robot
has one result: its first answer, or that it did not answer in time.

A resume proves its age by the robot's clock, which a ping tells first. However often it is repeated, it ends no stop
that came after that ping.
"""

from __future__ import annotations

import contextlib
import math
import secrets
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer, Arguments, CallHeader, RobotTime, decode_reply, encode_call
from eal_actors.wire.format.packing import check_version
from eal_actors.wire.format.parts import split
from eal_actors.wire.security.access import Rights
from eal_actors.wire.session import controller_config, open_session
from eal_actors.wire.transport import Transport

if TYPE_CHECKING:
    import zenoh

BROADCAST_S: Final = 3.0
"""Real seconds after which a robot that does not answer counts as absent."""

_RETRY_S: Final = 0.5
"""Real seconds after which a live robot without an answer is asked again."""

OnResult = Callable[[str, EALError | None], None]
"""Called with a robot's name and its error, None on success."""


def ask_robots(
    config: FleetConfig,
    robots: Sequence[str],
    method: str,
    arguments: Arguments = (),
    *,
    on_result: OnResult,
    timeout_s: float = BROADCAST_S,
) -> None:
    """Call a method of each robot urgently, as soon as the robot is reachable, and again until it answers.

    The method is one of the robot itself, and idempotent; the robots have addresses. `on_result` is called once for
    each robot: when it has answered, or after `timeout_s` real seconds. Raises UnavailableError if no router answers,
    and ConfigError if the keys are missing. Thread: blocks the caller, which also runs `on_result`.
    """
    broadcast = _Broadcast(config, robots, method, arguments, on_result)
    with open_session(controller_config(config, robots), timeout_s) as session:
        broadcast.run(session, timeout_s)


class _Broadcast:
    """One method call to many robots."""

    def __init__(
        self, config: FleetConfig, robots: Sequence[str], method: str, arguments: Arguments, on_result: OnResult
    ) -> None:
        self._config = config
        # Of robots that have not answered; inf: not seen yet. A router hears a revocation even if no robot is there.
        self._ask_at_s = dict.fromkeys(robots, 0.0 if method == keys.REVOKE else math.inf)
        self._method = method
        self._arguments = arguments
        self._on_result = on_result
        security = config.network.security
        self._caller = keys.ANYBODY if security is None else security.controller
        self._secret = secrets.token_hex(16)
        self._client = keys.client_id(self._caller, self._secret)
        self._sequence = 0
        self._clocks: dict[str, RobotTime | None] = {}  # of robots that have answered a ping
        self._inbox: deque[tuple[str, Answer | None, RobotTime | None]] = deque()
        self._waiter = new_waiter()

    def run(self, session: zenoh.Session, timeout_s: float) -> None:
        end_s = REAL_TIME.now() + timeout_s
        fleet = self._config.network_name
        answers = keys.answer_key(fleet, self._caller, self._secret, None)
        transport = Transport(session)
        transport.receive(answers, "broadcast answers", self._on_answer)
        transport.receive_tokens(keys.alive_key(fleet, None), "broadcast presence", self._on_liveliness)
        while self._ask_at_s and (now_s := REAL_TIME.now()) < end_s:
            for robot, ask_at_s in self._ask_at_s.items():
                if ask_at_s <= now_s:
                    self._ask(transport, robot, timeout_s)
                    self._ask_at_s[robot] = now_s + _RETRY_S
            next_s = min(end_s, *self._ask_at_s.values())
            if not self._inbox:
                REAL_TIME.wait(self._waiter, max(0.0, next_s - REAL_TIME.now()))
            self._handle_messages()
        for robot in self._ask_at_s:
            address = self._config.robots[robot].address
            reason = f"did not answer within {timeout_s:g} s at {address}, or {self._why_denied(robot)}"
            self._on_result(robot, UnavailableError(reason, robot=robot))

    def _why_denied(self, robot: str) -> str:
        """Return why a robot may not have granted the method; its own fleet file decides, not that of this program."""
        security = self._config.network.security
        if security is None or self._caller == keys.AUTHORITY_CALLER:  # which no fleet file names
            return "does not grant this"
        return Rights.by_file(security, robot).denied(keys.ROBOT, self._method) or "does not grant this"

    def _ask(self, transport: Transport, robot: str, timeout_s: float) -> None:
        self._sequence += 1
        clock = self._clocks.get(robot)
        method = keys.PING if clock is None and self._method == keys.RESUME else self._method
        proof = ("", 0.0, 0.0) if clock is None else (clock.era, clock.time_s, 0.0)
        header = CallHeader(self._client, 0, self._sequence, timeout_s, timeout_s, None, self._arguments, *proof)
        envelope, payload = encode_call(header)
        key = keys.CallKey(self._config.network_name, robot, keys.ROBOT, method, self._caller, self._secret)
        for attachment, content in split(envelope, payload):
            transport.put(keys.call_key(key), attachment, content, is_urgent=True)

    # Messages, in the readers' threads.

    def _on_answer(self, key: str, envelope: bytes, payload: bytes) -> None:
        with contextlib.suppress(ProtocolError):
            _, robot = keys.parse_robot(key)
            try:
                reply = decode_reply(envelope, payload)
                self._enqueue(robot, reply.answer, reply.time)
            except ProtocolError as error:
                self._enqueue(robot, error)

    def _on_liveliness(self, key: str, is_alive: bool) -> None:
        if not is_alive:
            return
        with contextlib.suppress(ProtocolError):
            _, robot, version = keys.parse_alive(key)
            try:
                check_version(version, "its heartbeat")
                self._enqueue(robot, None)
            except ProtocolError as error:
                self._enqueue(robot, error)

    def _enqueue(self, robot: str, answer: Answer | None, time: RobotTime | None = None) -> None:
        self._inbox.append((robot, answer, time))
        REAL_TIME.wake(self._waiter)

    def _handle_messages(self) -> None:
        while self._inbox:
            robot, answer, time = self._inbox.popleft()
            if robot not in self._ask_at_s:
                continue
            if isinstance(answer, dict):  # to a ping
                self._clocks.setdefault(robot, time)
            if answer is None or isinstance(answer, dict):  # or its token appeared
                self._ask_at_s[robot] = REAL_TIME.now()
            else:
                del self._ask_at_s[robot]
                self._on_result(robot, answer.at(robot) if isinstance(answer, EALError) else None)
