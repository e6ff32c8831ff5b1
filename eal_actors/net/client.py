"""RemoteRobot: one robot on the network, as an actor that takes the same calls as a robot of this process."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import ResourceCell
from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import Ping, RobotState, RobotView, RunningCommand
from eal_actors.device.link import FaultyLink
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.net import keys
from eal_actors.net.controller import Controller
from eal_actors.net.lane import Lane
from eal_actors.net.packing import check_version
from eal_actors.net.pinging import PING_TIMEOUT_S, Pinger
from eal_actors.net.questions import Questions
from eal_actors.net.runs import RunBoard, progress_from, translated_progress
from eal_actors.net.streams import RemoteFeeds
from eal_actors.net.timing import fleet_time_of
from eal_actors.net.welcome import Welcome
from eal_actors.net.wire import Answer, Event, Reply, RobotTime

CONNECT_S: Final = 3.0
"""Real seconds after which a fleet does not wait any longer for a robot that does not answer."""

_HELLO_TIMEOUT_S: Final = 2.0
_LEAVE_TIMEOUT_S: Final = 0.5
_STOP_TIMEOUT_S: Final = 2.0
_HELLO_RETRY_S: Final = 0.5
_LOOK_EACH_S: Final = 10.0


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
    link: FaultyLink


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
        view.controller_id = controller.client
        self._controller = controller
        self.pinger = Pinger()
        self.lane = Lane(self, controller)
        self._questions = Questions(spec.name, self.lane, controller, self.soon)
        self._feeds = RemoteFeeds(spec.name, self, controller, self.pinger, self.ask_robot)
        self._board = RunBoard()
        self._owed_stop: str | None = None
        self._is_greeting = False
        self._log = get_logger(robot=spec.name)

    @property
    def is_ready(self) -> bool:
        """See Connection."""
        return self.view.state is RobotState.READY and self._controller.is_alive(self.spec.name)

    # Life.

    def on_start(self) -> None:
        """Begin to look for the robot. Thread: the actor's own."""
        self._controller.add(self)
        self.actor_inbox.call_later(self.clock.of_real(CONNECT_S), self._wait_no_longer)
        self._look()

    def _look(self) -> None:
        """Compare clocks again, which drift apart, and learn of what no event told."""
        if self.is_ready:
            self.ping()
        self.actor_inbox.call_later(self.clock.of_real(_LOOK_EACH_S), self._look)

    def _wait_no_longer(self) -> None:
        if self.view.state is RobotState.STARTING:
            self._note_lost(f"does not answer at {self.spec.address}; it is looked for all the same")
        self.view.started.set(None)

    def met(self, version: int) -> None:
        """See Reached."""
        self.soon(lambda: self._meet(version))

    def _meet(self, version: int) -> None:
        try:
            check_version(version, "its sign of life")
        except ProtocolError as error:
            self._note_lost(f"cannot be spoken to: {error.message}")
            self.view.started.set(None)
        else:
            self._greet()

    def gone(self, reason: str) -> None:
        """See Reached."""
        self.soon(lambda: self._lose(reason))
        self.lane.exchanges.lose()

    def hear_reply(self, reply: Reply) -> None:
        """See Reached."""
        self.lane.hear_reply(reply)

    def look(self, now_s: float) -> None:
        """See Reached."""
        self.lane.look(now_s)

    def tell(self, event: Event) -> None:
        """See Reached."""
        call_id = event.call
        if call_id is None:
            self.soon(lambda: self._hear(event))
        elif event.kind == "result":
            self._board.end(call_id)
            self.lane.hear(event)
        elif event.kind == "began":
            self._board.begin(call_id, event.fields, event.stamp_s)
        elif event.kind == "progress" and (progress := progress_from(event.fields.get("progress"))) is not None:
            self._board.advance(call_id, progress)
            self.lane.hear_progress(call_id, translated_progress(progress, self._our_time))

    def soon(self, action: Callable[[], None]) -> None:
        """See Connection."""
        try:
            self.actor_inbox.call_soon(action)
        except EALError:
            self._log.debug("the connection has ended; something came too late")

    def _greet(self) -> None:
        if self._is_greeting or self.view.state is RobotState.STOPPED:
            return
        self._is_greeting = True
        self._questions.epoch = self.lane.renumber()
        name = self._controller.name_for_people
        self.ask_robot(keys.HELLO, (name,), _HELLO_TIMEOUT_S, self._welcome, miss=self._not_welcome)

    def _not_welcome(self) -> None:
        self._is_greeting = False
        self.actor_inbox.call_later(self.clock.of_real(_HELLO_RETRY_S), self._greet_if_alive)

    def _greet_if_alive(self) -> None:
        if self._controller.is_alive(self.spec.name) and self.view.state is not RobotState.READY:
            self._greet()

    def _welcome(self, answer: Answer) -> None:
        self._is_greeting = False
        try:
            welcome = Welcome.of(answer, self._controller.certificate)
            self._board.replace(welcome.running)
        except ProtocolError as error:
            self._note_lost(error.message)
            self._not_welcome()
            return
        self.lane.rights = welcome.rights
        self.view.not_ready = dict(welcome.not_ready)
        self._take_resources(welcome)
        self._take_stop(welcome.stopped)
        if self.view.state is not RobotState.READY:
            self._log.info("robot is ready", address=self.spec.address)
        self.view.state = RobotState.READY
        self.view.started.set(None)
        self.lane.reattach()
        self._feeds.renew()
        self.ping()  # tells the clocks' offset better than the greeting

    def _take_resources(self, welcome: Welcome) -> None:
        cells = dict(self.view.cells)
        for info in welcome.infos:
            cell = cells.get(info.name)
            if cell is None:
                spec, latch = self.spec, self.view.latch
                cell = cells[info.name] = ResourceCell(
                    spec.name, info.name, self.clock, self._controller.timekeeper, spec.timeout_s, spec.link, latch
                )
                cell.open_feed = self._feeds.open
            cell.info = info
            cell.actor = self.lane
        for name in cells.keys() - {info.name for info in welcome.infos}:
            cells[name].actor = None
            cells[name].error = UnavailableError("the robot does not have it any more")
        self.view.cells = cells
        self.view.problems = tuple(UnavailableError(problem, robot=self.spec.name) for problem in welcome.problems)

    def _take_stop(self, stopped: str | None) -> None:
        """Take in whether an emergency stop holds the robot; one that we still owe it is sent."""
        if stopped is not None:
            self._owed_stop = None
            self.view.latch.set(stopped)
        elif self._owed_stop is not None:
            self.stop_now(self._owed_stop)
        else:
            self.view.latch.clear()

    def _lose(self, reason: str) -> None:
        if self.view.state in (RobotState.READY, RobotState.LOST):  # the later reason is the true one
            self._note_lost(f"{reason}; it is looked for")

    def _note_lost(self, reason: str) -> None:
        error = UnavailableError(reason, robot=self.spec.name)
        if self.view.state is not RobotState.LOST:
            self._log.warning("robot is lost", reason=reason)
        self._board.clear()
        self.view.problems = (error,)
        for cell in self.view.cells.values():
            cell.error = UnavailableError(f"the robot {reason}")
            cell.actor = None
        self.view.state = RobotState.LOST

    def _hear(self, event: Event) -> None:
        if event.kind == "state":
            self._log.info("robot's state", state=event.fields.get("state"))
            self._greet()
        elif event.kind == "dead_man" and event.fields.get("client") == self._controller.client:
            self._log.warning("the robot has halted: it did not hear us", resource=event.fields.get("resource"))

    # The robot itself.

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

        self._questions.send(method, arguments, timeout_s, heard, lambda: self.soon(miss), resource)

    def ping(self) -> Future[Ping]:
        """See RobotConnection."""

        def read(answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> Ping:
            ping = self.pinger.take(answer, time, sent_s, answered_s)
            if isinstance(answer, dict):  # as it is, else it would have been refused
                self._board.replace(answer.get("running", ()), answer["received_s"])
            self.view.not_ready = dict(ping.not_ready)
            return replace(ping, running=self.running())

        return self._questions.ask(keys.PING, (), PING_TIMEOUT_S, read)

    def running(self) -> tuple[RunningCommand, ...]:
        """See RobotConnection."""
        return self._board.running(self._our_time)

    def _our_time(self, robot_s: float) -> float:
        """Return our fleet's time at a real time of the robot."""
        known = self.pinger.latest
        return fleet_time_of(self.clock, robot_s - (0.0 if known is None else known.offset.offset_s))

    def stop_now(self, reason: str) -> Future[None]:
        """See RobotConnection."""
        rights = self.lane.rights
        if rights is None or rights.allows(keys.ROBOT, keys.STOP):
            self.view.latch.set(reason)
            self._owed_stop = reason

        def held(*_: object) -> None:
            self._owed_stop = None

        return self._questions.ask(keys.STOP, (reason,), _STOP_TIMEOUT_S, held)

    def resume(self) -> Future[None]:
        """See RobotConnection."""

        def cleared(*_: object) -> None:
            self._owed_stop = None
            self.view.latch.clear()

        return self._questions.ask(keys.RESUME, (), _STOP_TIMEOUT_S, cleared)

    def release(self, resources: Sequence[str]) -> Future[None]:
        """See RobotConnection."""
        return self._questions.ask(keys.RELEASE, tuple(resources), _STOP_TIMEOUT_S, lambda *_: None)

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
        self._note_lost(f"cannot be spoken to: its connection crashed: {error_text(error)}")
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
