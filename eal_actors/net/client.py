"""RemoteRobot: one robot on the network, as an actor that takes the same calls as a robot of this process."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NoReturn

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import Ping, RobotState, RobotView
from eal_actors.clock import REAL_TIME, Clock
from eal_actors.errors import EALError, ProtocolError, RemoteError, UnavailableError, shown
from eal_actors.link import Link
from eal_actors.log import get_logger
from eal_actors.net import keys
from eal_actors.net.calling import READS, split_arguments
from eal_actors.net.exchange import Exchange
from eal_actors.net.pinging import PING_TIMEOUT_S, Pinger
from eal_actors.net.receipts import Stamper
from eal_actors.net.resource_info import info_from
from eal_actors.net.streams import RemoteFeeds
from eal_actors.net.timing import fleet_time_of, real_time_of
from eal_actors.net.wire import ACCEPTED, Answer, CallHeader, CallId, Event, RobotTime, encode_call

if TYPE_CHECKING:
    from eal_actors.net.controller import Controller

TTL_S: Final = 1.0
"""How old a command may be when a robot begins it, in real seconds."""

CONNECT_S: Final = 3.0
"""Real seconds after which a fleet does not wait any longer for a robot that does not answer."""

_HELLO_TIMEOUT_S: Final = 2.0
_LEAVE_TIMEOUT_S: Final = 0.5
_ANSWER_S: Final = 2.0
"""Real seconds in which a robot answers a command, if only that it has accepted it."""

_RETRY_S: Final = 0.05
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
        self._stamper = Stamper(controller.client)
        self._commands: dict[CallId, Call[Any]] = {}
        self._heard: tuple[RobotTime, float] | None = None
        self._pinger = Pinger()
        self._feeds = RemoteFeeds(spec.name, self, controller, self._pinger, self._ask)
        self._owed_stop: str | None = None
        self._is_greeting = False
        self._log = get_logger(robot=spec.name)

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
        """It tells something. Thread: any; does not block."""
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
        self._stamper.reconnect()
        self._ask(keys.HELLO, (), _HELLO_TIMEOUT_S, self._welcome, miss=self._not_welcome)

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
        except (ProtocolError, KeyError, TypeError) as error:
            self._note_lost(f"greets in a way that makes no sense: {shown(error)}")
            self._not_welcome()
            return
        cells = dict(self.view.cells)
        for info in infos:
            cell = cells.get(info.name)
            if cell is None:
                spec, latch = self.spec, self.view.latch
                cell = cells[info.name] = ResourceCell(
                    spec.name, info.name, self.clock, self.actor_inbox, spec.timeout_s, spec.link, latch
                )
                cell.open_feed = self._feeds.open
            cell.info = info
            cell.actor = self
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
        self._reattach()
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

    # Calls.

    def on_receive(self, message: Any) -> Any:
        """Send a call. Thread: the actor's own."""
        if isinstance(message, Call):
            self._send(message)
            return None
        return super().on_receive(message)

    @property
    def resource(self) -> NoReturn:
        """The resource itself is in another process (Source: thesis §4.5).

        Raises:
            RemoteError: always.
        """
        raise RemoteError("the resource itself cannot be had through a network", robot=self.spec.name)

    def _send(self, call: Call[Any]) -> None:
        left_s = (call.deadline_s or 0.0) - self.clock.now()
        if call.stops:
            left_s = max(left_s, call.cell.timeout_s)
        elif call.done():
            return
        if left_s <= 0:
            call.expire()
            return
        plain, data = split_arguments(call)
        stamper, is_command = self._stamper, call.method not in READS and call.method != keys.HALT
        try:
            start_s = None if call.start_s is None else self._time_on_robot(call.start_s)
            if call.method not in READS:  # halts too, so that what they overtake on their way is refused
                self._take_in_time()
                stamp = stamper.stamp(TTL_S, REAL_TIME.now())
                client, epoch, sequence = stamp.call
                header = CallHeader(
                    client, epoch, sequence, TTL_S, left_s, start_s, plain, stamp.era, stamp.echo_s, stamp.held_s
                )
            else:
                header = CallHeader(stamper.client, stamper.epoch, 0, left_s, left_s, None, plain)
            envelope, payload = encode_call(header, data)
        except EALError as error:
            call.fail(error)
            return
        if is_command:
            self._commands[header.call_id] = call
        key = keys.method_key(self._controller.fleet, self.spec.name, call.cell.name, call.method)
        exchange = Exchange(
            partial(self._take_command if is_command else self._take_reading, call, header),
            lambda: self.soon(lambda: self._miss(call, header, is_command=is_command)),
        )
        real_s = left_s / self.clock.of_real(1.0)
        wait_s = min(real_s, _ANSWER_S) if is_command else real_s
        self._controller.get(key, exchange.reply, exchange.drop, envelope, payload, wait_s, is_urgent=call.stops)

    def _take_reading(self, call: Call[Any], _: CallHeader, answer: Answer, time: RobotTime | None) -> None:
        """Finish a call that only reads. Thread: zenoh's, which may wake those who wait, but run no callback."""
        self._note_time(time)
        if isinstance(answer, EALError):
            is_finished = call.finish_unless_watched(None, answer.at(self.spec.name, call.cell.name))
        else:
            is_finished = answer is not ACCEPTED and call.finish_unless_watched(answer, None)
        if not is_finished:
            self.soon(lambda: _conclude(call, answer))

    def _take_command(self, call: Call[Any], header: CallHeader, answer: Answer, time: RobotTime | None) -> None:
        """Finish a command, unless it goes on. Thread: zenoh's."""
        self._note_time(time)
        if answer is not ACCEPTED:
            self.soon(lambda: self._end_command(call, header, answer, None if time is None else time.began_s))

    def _end_command(self, call: Call[Any], header: CallHeader, answer: Answer, began_s: float | None) -> None:
        self._commands.pop(header.call_id, None)
        self._note_begin(call, began_s)
        _conclude(call, answer)

    def _time_on_robot(self, fleet_s: float) -> float:
        real_s = real_time_of(self.clock, fleet_s)
        return real_s + self._pinger.offset(real_s).offset_s

    def _note_begin(self, call: Call[Any], began_s: object) -> None:
        """Take in when a command began by the robot's clock, and how well that is known by ours."""
        if isinstance(began_s, float) and call.start_s is not None:
            offset = self._pinger.offset(REAL_TIME.now())
            call.began_s = fleet_time_of(self.clock, began_s - offset.offset_s)
            call.began_error_s = self.clock.of_real(offset.error_s)

    def _note_time(self, time: RobotTime | None) -> None:
        """Keep the robot's clock for the next stamp. Thread: any, for it is one assignment."""
        if time is not None:
            self._heard = time, REAL_TIME.now()

    def _take_in_time(self) -> None:
        """Let the stamper know what the robot's clock showed last."""
        heard, self._heard = self._heard, None
        if heard is not None:
            time, now_s = heard
            self._stamper.heard(time.era, time.time_s, now_s)

    def _miss(self, call: Call[Any], header: CallHeader, *, is_command: bool) -> None:
        """There was no answer: what only reads is asked again, a command never."""
        if call.done():
            self._commands.pop(header.call_id, None)
        elif not is_command:
            if self.view.state is RobotState.READY and self.clock.now() < (call.deadline_s or 0.0):
                self.actor_inbox.call_later(self.clock.of_real(_RETRY_S), lambda: self._send(call))
            else:
                call.fail(UnavailableError("the robot did not answer"))
        elif self.view.state is RobotState.READY and self._controller.is_alive(self.spec.name):
            self.actor_inbox.call_later(self.clock.of_real(_RETRY_S), self._reattach)

    def stop_activity_of(self, call: Call[Any]) -> None:
        """See CallTarget."""
        self.soon(lambda: self._cancel(call))

    def _cancel(self, call: Call[Any]) -> None:
        for call_id, running in list(self._commands.items()):
            if running is call:
                del self._commands[call_id]
                self._ask(keys.CANCEL, (call_id.epoch, call_id.sequence), TTL_S)

    def _hear(self, event: Event) -> None:
        if event.kind == "result" and event.call is not None and event.answer is not None:
            call = self._commands.pop(event.call, None)
            if call is not None:
                self._note_begin(call, event.fields.get("began_s"))
                _conclude(call, event.answer)
        elif event.kind == "state":
            self._log.info("robot's state", state=event.fields.get("state"))
            self._greet()
        elif event.kind == "dead_man" and event.fields.get("client") == self._controller.client:
            self._log.warning("the robot has halted: it did not hear us", resource=event.fields.get("resource"))

    def _reattach(self) -> None:
        """Ask what has become of commands whose answer did not come."""
        mine = [call_id for call_id, call in self._commands.items() if not call.done()]
        if mine:
            numbers = tuple(number for call_id in mine for number in (call_id.epoch, call_id.sequence))
            self._ask(keys.REATTACH, numbers, _HELLO_TIMEOUT_S, self._forget_unknown)

    def _forget_unknown(self, answer: Answer) -> None:
        if not isinstance(answer, dict):
            return
        for epoch, sequence in answer.get("unknown", ()):
            call = self._commands.pop(CallId(self._controller.client, epoch, sequence), None)
            if call is not None:
                call.fail(UnavailableError("the robot knows nothing of it: it was lost, or the robot was restarted"))

    # The robot itself.

    def ask(
        self, method: str, arguments: tuple[str | int, ...] = (), timeout_s: float = 2.0
    ) -> Future[Mapping[str, Any]]:
        """Ask the robot itself, such as for a ping; fails with UnavailableError where nothing is answered.

        Thread: any; does not block.
        """
        future: Future[Mapping[str, Any]] = Future(REAL_TIME, REAL_TIME.now() + timeout_s + _GRACE_S)

        def take(answer: Answer) -> None:
            if isinstance(answer, EALError):
                future.set_exception(answer.at(self.spec.name))
            else:
                future.set(answer if isinstance(answer, dict) else {})

        def miss() -> None:
            future.set_exception(UnavailableError("the robot did not answer", robot=self.spec.name))

        self.soon(lambda: self._ask(method, arguments, timeout_s, take, miss=miss))
        return future

    def _ask(
        self,
        method: str,
        arguments: tuple[str | int, ...],
        timeout_s: float,
        take: Callable[[Answer], None] = lambda _: None,
        resource: str = keys.ROBOT,
        miss: Callable[[], None] = lambda: None,
    ) -> None:
        header = CallHeader(self._stamper.client, self._stamper.epoch, 0, timeout_s, timeout_s, None, arguments)
        envelope, payload = encode_call(header)
        key = keys.method_key(self._controller.fleet, self.spec.name, resource, method)
        sent_s = REAL_TIME.now()

        def heard(answer: Answer, time: RobotTime | None) -> None:
            answered_s = REAL_TIME.now()
            self._note_time(time)
            self.soon(lambda: self._pinger.note(time, sent_s, answered_s))
            self.soon(lambda: take(answer))

        exchange = Exchange(heard, lambda: self.soon(miss))
        is_urgent = method in (keys.STOP, keys.RESUME)
        self._controller.get(key, exchange.reply, exchange.drop, envelope, payload, timeout_s, is_urgent=is_urgent)

    def ping(self) -> Future[Ping]:
        """See RobotConnection."""
        future: Future[Ping] = Future(REAL_TIME, REAL_TIME.now() + PING_TIMEOUT_S + _GRACE_S)
        self.soon(lambda: self._ping(future))
        return future

    def _ping(self, future: Future[Ping]) -> None:
        header = CallHeader(self._stamper.client, self._stamper.epoch, 0, PING_TIMEOUT_S, PING_TIMEOUT_S)
        envelope, payload = encode_call(header)
        key = keys.method_key(self._controller.fleet, self.spec.name, keys.ROBOT, keys.PING)
        sent_s = REAL_TIME.now()

        def heard(answer: Answer, time: RobotTime | None) -> None:
            answered_s = REAL_TIME.now()
            self._note_time(time)
            self.soon(lambda: self._pinger.take(future, answer, time, sent_s, answered_s))

        def miss() -> None:
            future.set_exception(UnavailableError("the robot did not answer", robot=self.spec.name))

        exchange = Exchange(heard, lambda: self.soon(miss))
        self._controller.get(key, exchange.reply, exchange.drop, envelope, payload, PING_TIMEOUT_S)

    def stop_now(self, reason: str) -> Future[None]:
        """See RobotConnection."""
        self.view.latch.set(reason)
        self._owed_stop = reason

        def held(_: Mapping[str, Any]) -> None:
            self._owed_stop = None

        return self.ask(keys.STOP, (reason,)).map(held)

    def resume(self) -> Future[None]:
        """See RobotConnection."""

        def cleared(_: Mapping[str, Any]) -> None:
            self._owed_stop = None
            self.view.latch.clear()

        return self.ask(keys.RESUME).map(cleared)

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
        for call in self._commands.values():
            call.fail(error.copy())
        self._commands.clear()
        self._controller.remove(self)
        if was_ready:
            self.actor_inbox.call_later(self.clock.of_real(_LEAVE_TIMEOUT_S), self._stop)
            self._ask(keys.LEAVE, (), _LEAVE_TIMEOUT_S, lambda _: self._stop(), miss=self._stop)
        else:
            self._stop()

    def force_down(self) -> None:
        """See RobotConnection."""
        self.soon(self._stop)

    def on_stop(self) -> None:
        """Tell everybody. Thread: the actor's own."""
        self._controller.remove(self)
        self._feeds.close()
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


def _conclude(call: Call[Any], answer: Answer) -> None:
    if isinstance(answer, EALError):
        call.fail(answer)
    elif answer is ACCEPTED:
        call.fail(ProtocolError("the robot has accepted a call that cannot take long"))
    else:
        call.set(answer)
