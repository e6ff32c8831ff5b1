"""Questions: what a controller asks a robot itself, beside the calls to its resources."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import AccessDeniedError, EALError, UnavailableError
from eal_actors.net import keys
from eal_actors.net.controller import Controller
from eal_actors.net.exchange import Question
from eal_actors.net.lane import Lane
from eal_actors.net.wire import Answer, CallHeader, RobotTime

T = TypeVar("T")

_GRACE_S: Final = 1.0
"""How late it may be told that there is no answer, in real seconds."""

Take = Callable[[Answer, RobotTime | None, float, float], T]
"""Takes an answer, the robot's clock if it came along, and our clock as the call left and as the answer came."""


class Questions:
    """Asks one robot.

    Args:
        robot: its name.
        lane: the calls to it.
        controller: the fleet's end of the network.
        soon: runs an action in the connection's thread.

    Attributes:
        epoch: how often we have connected to it.

    Thread: any; nothing blocks.
    """

    def __init__(
        self, robot: str, lane: Lane, controller: Controller, soon: Callable[[Callable[[], None]], None]
    ) -> None:
        self.epoch = 0
        self._robot = robot
        self._lane = lane
        self._soon = soon
        self._controller = controller

    def ask(self, method: str, arguments: tuple[str | int, ...], timeout_s: float, read: Take[T]) -> Future[T]:
        """Ask the robot itself; `read`, in zenoh's thread, makes of the answer what the future comes to.

        The future fails with what the robot answered, with AccessDeniedError where it does not grant this, and with
        UnavailableError where nothing is answered.
        """
        future: Future[T] = Future(REAL_TIME, REAL_TIME.now() + timeout_s + _GRACE_S)
        name, later = self._robot, self._controller.later

        def take(answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
            try:
                if isinstance(answer, EALError):
                    raise answer
                value = read(answer, time, sent_s, answered_s)
            except EALError as error:
                future.settle(None, error.at(name), later)
            else:
                future.settle(value, None, later)

        def miss() -> None:
            future.settle(None, UnavailableError("the robot did not answer", robot=name), later)

        self.send(method, arguments, timeout_s, take, miss)
        return future

    def send(
        self,
        method: str,
        arguments: tuple[str | int, ...],
        timeout_s: float,
        take: Take[None],
        miss: Callable[[], None],
        resource: str = keys.ROBOT,
    ) -> None:
        """Ask; `take` or `miss` tells what comes of it, in zenoh's thread, or at once where it is refused."""
        robot, lane = self._robot, self._lane
        try:
            if lane.rights is not None:
                lane.rights.check(resource, method)
        except AccessDeniedError as error:
            take(error, None, 0.0, 0.0)
            return
        controller = self._controller
        header = CallHeader(controller.client, self.epoch, lane.number(), timeout_s, timeout_s, None, arguments)
        key = controller.call_key(robot, resource, method)
        is_urgent = method in (keys.STOP, keys.RESUME)
        question = Question(
            controller, robot, lane.exchanges, key, header, take, miss, is_urgent=is_urgent, insist=self._soon
        )
        if is_urgent:
            controller.urge(question)
        elif not controller.sender.submit(question):
            miss()
