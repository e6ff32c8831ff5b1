"""RemoteRobot: one robot on the network, as an actor that takes the same calls as a robot of this process."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import ResourceCell
from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import Ping, RobotState, RobotView
from eal_actors.clock import REAL_TIME, Clock
from eal_actors.errors import EALError, ProtocolError, UnavailableError, shown
from eal_actors.link import Link
from eal_actors.log import get_logger
from eal_actors.net import keys
from eal_actors.net.exchange import Question
from eal_actors.net.lane import Lane
from eal_actors.net.pinging import PING_TIMEOUT_S, Pinger, texts
from eal_actors.net.resource_info import info_from
from eal_actors.net.streams import RemoteFeeds
from eal_actors.net.wire import Answer, CallHeader, Event, RobotTime

if TYPE_CHECKING:
    from eal_actors.net.controller import Controller

T = TypeVar("T")

CONNECT_S: Final = 3.0
"""Real seconds after which a fleet does not wait any longer for a robot that does not answer."""

_HELLO_TIMEOUT_S: Final = 2.0
_LEAVE_TIMEOUT_S: Final = 0.5
_STOP_TIMEOUT_S: Final = 2.0
_GRACE_S: Final = 0.5
"""What zenoh may be late with telling that there is no answer, in real seconds."""
_HELLO_RETRY_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class RemoteSpec:
    """What a remote robot needs to know.

    Attributes:
        name: the robot's name.
        address: where it is, for messages.
        clock: the fleet's clock.
        timeout_s: the default deadline of a call.
        link: what calls pass on their way.
    """

    name: str
    address: str
    clock: Clock
    timeout_s: float
    link: Link


class RemoteRobot(EALActor):
    """Speaks with one robot.

    Args:
        spec: which robot.
        view: what everybody may read of it.
        controller: the fleet's end of the network.

    Thread: an actor; zenoh's threads only put answers into its mailbox.
    """

    is_remote = True

    def __init__(self, spec: RemoteSpec, view: RobotView, controller: Controller) -> None:
        super().__init__(spec.name, spec.clock)
        self.spec = spec
        self.view = view
        self._controller = controller
        self.pinger = Pinger()
        self.lane = Lane(self, controller)
        self._epoch = 0
        self._feeds = RemoteFeeds(spec.name, self, controller, self.pinger, self.ask_robot)
        self._owed_stop: str | None = None
        self._is_greeting = False
        self._log = get_logger(robot=spec.name)

    @property
    def is_ready(self) -> bool:
        """Whether the robot is there, and has let us in. Thread: any."""
        return self.view.state is RobotState.READY and self._controller.is_alive(self.spec.name)

    # Life.

    def on_start(self) -> None:
        """Begin to look for the robot. Thread: the actor's own."""
        self._controller.add(self)
        self.actor_inbox.call_later(self.clock.of_real(CONNECT_S), self._wait_no_longer)

    def _wait_no_longer(self) -> None:
        if self.view.state is RobotState.STARTING:
            self._note_lost(f"does not answer at {self.spec.address}; it is looked for all the same")
        self.view.started.set(None)

    def found(self) -> None:
        """Its sign of life is there. Thread: any; does not block."""
        self.soon(self._greet)

    def gone(self, reason: str) -> None:
        """Its sign of life is there no more. Thread: any; does not block."""
        self.soon(lambda: self._lose(reason))

    def tell(self, event: Event) -> None:
        """It tells something. Thread: zenoh's; does not block."""
        if event.kind == "result":
            self.lane.hear(event)
            return
        self.soon(lambda: self._hear(event))

    def soon(self, action: Callable[[], None]) -> None:
        """Run an action in this actor's thread, unless it has ended. Thread: any; does not block."""
        try:
            self.actor_inbox.call_soon(action)
        except EALError:
            self._log.debug("the connection has ended; something came too late")

    def _greet(self) -> None:
        if self._is_greeting or self.view.state is RobotState.STOPPED:
            return
        self._is_greeting = True
        self._epoch = self.lane.renumber()
        self.ask_robot(keys.HELLO, (), _HELLO_TIMEOUT_S, self._welcome, miss=self._not_welcome)

    def _not_welcome(self) -> None:
        self._is_greeting = False
        self.actor_inbox.call_later(self.clock.of_real(_HELLO_RETRY_S), self._greet_if_alive)

    def _greet_if_alive(self) -> None:
        if self._controller.is_alive(self.spec.name) and self.view.state is not RobotState.READY:
            self._greet()

    def _welcome(self, answer: Answer) -> None:
        self._is_greeting = False
        if not isinstance(answer, dict):
            reason = answer.message if isinstance(answer, EALError) else f"answered {answer!r}"
            self._note_lost(f"does not let us in: {reason}")
            self._not_welcome()
            return
        try:
            infos = [info_from(fields) for fields in answer["resources"]]
            stopped, problems = answer["stopped"], [str(problem) for problem in answer["problems"]]
            self.view.not_ready = texts(answer.get("not_ready", {}))
        except (ProtocolError, AttributeError, KeyError, TypeError) as error:
            self._note_lost(f"greets in a way that makes no sense: {shown(error)}")
            self._not_welcome()
            return
        cells = dict(self.view.cells)
        for info in infos:
            cell = cells.get(info.name)
            if cell is None:
                spec, latch = self.spec, self.view.latch
                cell = cells[info.name] = ResourceCell(
                    spec.name, info.name, self.clock, self._controller.timekeeper, spec.timeout_s, spec.link, latch
                )
                cell.open_feed = self._feeds.open
            cell.info = info
            cell.actor = self.lane
        for name in cells.keys() - {info.name for info in infos}:
            cells[name].actor = None
            cells[name].error = UnavailableError("the robot does not have it any more")
        self.view.cells = cells
        self.view.problems = tuple(UnavailableError(problem, robot=self.spec.name) for problem in problems)
        if stopped is not None:
            self._owed_stop = None
            self.view.latch.set(str(stopped))
        elif self._owed_stop is not None:
            self.stop_now(self._owed_stop)
        else:
            self.view.latch.clear()
        if self.view.state is not RobotState.READY:
            self._log.info("robot is ready", address=self.spec.address)
        self.view.state = RobotState.READY
        self.view.started.set(None)
        self.lane.reattach()
        self._feeds.renew()

    def _lose(self, reason: str) -> None:
        if self.view.state is RobotState.READY:
            self._note_lost(f"{reason}; it is looked for")

    def _note_lost(self, reason: str) -> None:
        error = UnavailableError(reason, robot=self.spec.name)
        if self.view.state is not RobotState.LOST:
            self._log.warning("robot is lost", reason=reason)
        self.view.state = RobotState.LOST
        self.view.problems = (error,)
        for cell in self.view.cells.values():
            cell.error = UnavailableError(f"the robot {reason}")
            cell.actor = None

    def _hear(self, event: Event) -> None:
        if event.kind == "state":
            self._log.info("robot's state", state=event.fields.get("state"))
            self._greet()
        elif event.kind == "dead_man" and event.fields.get("client") == self._controller.client:
            self._log.warning("the robot has halted: it did not hear us", resource=event.fields.get("resource"))

    # The robot itself.

    def ask(
        self, method: str, arguments: tuple[str | int, ...] = (), timeout_s: float = 2.0
    ) -> Future[Mapping[str, Any]]:
        """Ask the robot itself; fails with UnavailableError where nothing is answered. Thread: any; does not block."""
        return self._ask(method, arguments, timeout_s, lambda answer, *_: answer if isinstance(answer, dict) else {})

    def _ask(
        self,
        method: str,
        arguments: tuple[str | int, ...],
        timeout_s: float,
        read: Callable[[Answer, RobotTime | None, float, float], T],
    ) -> Future[T]:
        """Ask the robot itself; `read`, in zenoh's thread, makes of the answer what the future comes to."""
        future: Future[T] = Future(REAL_TIME, REAL_TIME.now() + timeout_s + _GRACE_S)
        later = self._controller.later

        def take(answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
            try:
                if isinstance(answer, EALError):
                    raise answer
                value = read(answer, time, sent_s, answered_s)
            except EALError as error:
                future.settle(None, error.at(self.spec.name), later)
            else:
                future.settle(value, None, later)

        def miss() -> None:
            future.settle(None, UnavailableError("the robot did not answer", robot=self.spec.name), later)

        self._send(method, arguments, timeout_s, take, miss)
        return future

    def ask_robot(
        self,
        method: str,
        arguments: tuple[str | int, ...],
        timeout_s: float,
        take: Callable[[Answer], None] = lambda _: None,
        resource: str = keys.ROBOT,
        miss: Callable[[], None] = lambda: None,
    ) -> None:
        """Ask the robot itself, or for a stream; what comes of it is told in this actor's thread.

        Thread: any; does not block.
        """

        def heard(answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
            self.pinger.note(time, sent_s, answered_s)
            self.soon(lambda: take(answer))

        self._send(method, arguments, timeout_s, heard, lambda: self.soon(miss), resource)

    def _send(
        self,
        method: str,
        arguments: tuple[str | int, ...],
        timeout_s: float,
        take: Callable[[Answer, RobotTime | None, float, float], None],
        miss: Callable[[], None],
        resource: str = keys.ROBOT,
    ) -> None:
        key = keys.method_key(self._controller.fleet, self.spec.name, resource, method)
        header = CallHeader(self._controller.client, self._epoch, 0, timeout_s, timeout_s, None, arguments)
        is_urgent = method in (keys.STOP, keys.RESUME)
        question = Question(
            self._controller, key, header, self._noting(take), miss, is_urgent=is_urgent, insist=self.soon
        )
        if is_urgent:
            self._controller.urge(question)
        elif not self._controller.sender.submit(question):
            miss()

    def _noting(
        self, take: Callable[[Answer, RobotTime | None, float, float], None]
    ) -> Callable[[Answer, RobotTime | None, float, float], None]:
        def heard(answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
            self.lane.note_time(time)
            take(answer, time, sent_s, answered_s)

        return heard

    def ping(self) -> Future[Ping]:
        """See RobotConnection."""

        def read(answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> Ping:
            ping = self.pinger.take(answer, time, sent_s, answered_s)
            self.view.not_ready = dict(ping.not_ready)
            return ping

        return self._ask(keys.PING, (), PING_TIMEOUT_S, read)

    def stop_now(self, reason: str) -> Future[None]:
        """See RobotConnection."""
        self.view.latch.set(reason)
        self._owed_stop = reason

        def held(*_: object) -> None:
            self._owed_stop = None

        return self._ask(keys.STOP, (reason,), _STOP_TIMEOUT_S, held)

    def resume(self) -> Future[None]:
        """See RobotConnection."""

        def cleared(*_: object) -> None:
            self._owed_stop = None
            self.view.latch.clear()

        return self._ask(keys.RESUME, (), _STOP_TIMEOUT_S, cleared)

    # The end.

    def shut_down(self) -> None:
        """See RobotConnection."""
        self.soon(self._leave)

    def _leave(self) -> None:
        was_ready = self.view.state is RobotState.READY
        self.view.state = RobotState.STOPPED
        error = UnavailableError("the robot is disconnected")
        for cell in self.view.cells.values():
            cell.close(error)
        self.lane.close(error)
        self._controller.remove(self)
        if was_ready:
            self.actor_inbox.call_later(self.clock.of_real(_LEAVE_TIMEOUT_S), self._stop)
            self.ask_robot(keys.LEAVE, (), _LEAVE_TIMEOUT_S, lambda _: self._stop(), miss=self._stop)
        else:
            self._stop()

    def force_down(self) -> None:
        """See RobotConnection."""
        self.soon(self._stop)

    def on_stop(self) -> None:
        """Tell everybody. Thread: the actor's own."""
        self._controller.remove(self)
        self._feeds.close()
        self.lane.close(UnavailableError("the robot is disconnected"))
        self.view.state = RobotState.STOPPED
        self.view.started.set(None)
        self.view.stopped.set(None)

    def on_crash(self, error: BaseException) -> None:
        """Fail: the connection is no more. Thread: the actor's own."""
        self._note_lost(f"cannot be spoken to: its connection crashed: {shown(error)}")
        self.on_stop()

    def is_at_work(self) -> bool:
        """See RobotConnection."""
        return threading.current_thread() is self.thread

    def join(self, timeout_s: float) -> list[str]:
        """See RobotConnection."""
        thread = self.thread
        if thread is None or thread is threading.current_thread():
            return []
        with self.clock.outside():
            thread.join(max(0.0, timeout_s))
        return [thread.name] if thread.is_alive() else []
