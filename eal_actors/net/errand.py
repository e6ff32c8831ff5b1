"""One word to many robots in a hurry, such as an emergency stop: without greetings, and the absent delay nobody."""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

from eal_actors.clock import REAL_TIME, new_waiter
from eal_actors.errors import EALError, UnavailableError, shown
from eal_actors.log import get_logger
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.net import keys
from eal_actors.net.exchange import Exchange
from eal_actors.net.session import controller_config, open_session
from eal_actors.net.wire import Answer, CallHeader, RobotTime, encode_call

if TYPE_CHECKING:
    import zenoh

ERRAND_S: Final = 3.0
"""Real seconds after which a robot that does not answer counts as absent."""

_RETRY_S: Final = 0.05

Tell = Callable[[str, EALError | None], None]
"""Called with a robot's name and what went wrong, None if it has done as asked."""


def ask_robots(
    config: FleetConfig,
    robots: Sequence[str],
    method: str,
    arguments: tuple[str | int, ...] = (),
    *,
    tell: Tell,
    timeout_s: float = ERRAND_S,
) -> None:
    """Ask each robot one thing as soon as it can be reached, by the urgent way, and again until it answers.

    Args:
        config: the fleet.
        robots: names of robots that have an address.
        method: of the robot itself, one that does no harm if it comes twice.
        arguments: the method's.
        tell: called once for each robot, at once when it has answered, and for those that are absent at the end.
        timeout_s: real seconds to wait at most.

    Raises:
        UnavailableError: no router answers.
        ConfigError: the keys are missing.

    Thread: blocks the caller, which is the one to call `tell`.
    """
    errand = _Errand(config, robots, method, arguments, tell)
    with open_session(controller_config(config, robots), timeout_s) as session:
        errand.run(session, timeout_s)


class _Errand:
    """What is still to be asked, and what was answered."""

    def __init__(
        self, config: FleetConfig, robots: Sequence[str], method: str, arguments: tuple[str | int, ...], tell: Tell
    ) -> None:
        self._config = config
        self._waiting = dict.fromkeys(robots, False)  # whether a query is under way
        self._method = method
        self._arguments = arguments
        self._tell = tell
        self._client = secrets.token_hex(8)
        self._news: deque[tuple[str, Answer | None]] = deque()
        self._waiter = new_waiter()

    def run(self, session: zenoh.Session, timeout_s: float) -> None:
        end_s = REAL_TIME.now() + timeout_s
        while self._waiting and (left_s := end_s - REAL_TIME.now()) > 0:
            for robot, is_asked in self._waiting.items():
                if not is_asked:
                    self._ask(session, robot, left_s)
            REAL_TIME.wait(self._waiter, min(_RETRY_S, left_s))
            self._take_news()
        for robot in self._waiting:
            address = self._config.robots[robot].address
            reason = f"did not answer within {timeout_s:g} s at {address}, or does not grant this"
            self._tell(robot, UnavailableError(reason, robot=robot))

    def _ask(self, session: zenoh.Session, robot: str, left_s: float) -> None:
        import zenoh

        self._waiting[robot] = True
        header = CallHeader(self._client, 0, 0, left_s, left_s, None, self._arguments)
        envelope, _ = encode_call(header)
        exchange = Exchange(partial(self._answered, robot), partial(self._missed, robot))
        try:
            session.get(
                keys.method_key(self._config.name, robot, keys.ROBOT, self._method),
                zenoh.handlers.Callback(exchange.reply, exchange.drop, indirect=False),
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=left_s,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
                attachment=envelope,
            )
        except zenoh.ZError as error:
            get_logger(robot=robot).debug("a query could not be sent", reason=shown(error))
            self._missed(robot)

    def _answered(self, robot: str, answer: Answer, _: RobotTime | None) -> None:
        """Thread: zenoh's."""
        self._news.append((robot, answer))
        REAL_TIME.wake(self._waiter)

    def _missed(self, robot: str) -> None:
        """Thread: zenoh's. It wakes nobody: there is to be some time until the next query."""
        self._news.append((robot, None))

    def _take_news(self) -> None:
        while self._news:
            robot, answer = self._news.popleft()
            if answer is None:
                self._waiting[robot] = False
            elif self._waiting.pop(robot, None) is not None:
                self._tell(robot, answer.at(robot) if isinstance(answer, EALError) else None)
