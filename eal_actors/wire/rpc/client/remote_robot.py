"""RemoteRobot: a robot in another process, as an actor with the interface of a robot in this process.

Handshakes, losses and their order belong to this thread alone: a robot is ready only after a handshake since its last
loss. A command is never sent again, since it might run twice. After a loss its outcome is asked for; after twice the
dead-man's time, when the robot has halted in any case, it fails. A stop is sent again until the robot confirms it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import ResourceCell
from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import Ping, RobotState, RobotView, RunningCommand
from eal_actors.device.link import FaultyLink
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, ProtocolError, RobotFailedError, UnavailableError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.managers.fleet_model import RobotConfig
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer, RobotEvent, RobotTime
from eal_actors.wire.format.packing import check_version
from eal_actors.wire.rpc.client.call_queue import CallQueue
from eal_actors.wire.rpc.client.channel import CONNECTED, Channel
from eal_actors.wire.rpc.client.clock_offset import PING_PERIOD_S, PING_TIMEOUT_S
from eal_actors.wire.rpc.client.command_tracking import CommandBoard, localized_progress
from eal_actors.wire.rpc.client.controller import Controller, RobotListener
from eal_actors.wire.rpc.client.handshake import Handshake
from eal_actors.wire.streams.reader import RemoteFeeds

CONNECT_S: Final = 3.0
"""Real seconds after which a fleet no longer waits for a robot that does not answer, unless others still begin to."""

_REQUEST_TIMEOUT_S: Final = 2.0
_LEAVE_TIMEOUT_S: Final = 0.5
_HELLO_RETRY_S: Final = 0.5


class RemoteRobot(EALActor):
    """Connection to one remote robot; implements RobotConnection.

    Thread: an actor. The readers' threads queue changes of the robot's state in its mailbox; replies, and events of
        commands, they handle themselves.
    """

    is_remote = True

    def __init__(
        self, config: RobotConfig, address: str, link: FaultyLink, view: RobotView, controller: Controller
    ) -> None:
        super().__init__(config.name, view.clock)
        self._timeout_s = config.timeout_s
        self.address = address
        self._link = link
        self.view = view
        view.controller_id = controller.client
        self._controller = controller
        self._channel = Channel(self, view, controller)
        self.calls: Final = CallQueue(self._channel, config.mailbox)
        self._feeds = RemoteFeeds(self._channel)
        self._board = CommandBoard()
        lose_all, calls = self._channel.lose_all, self.calls
        self._listener = RobotListener(
            self.name, self._on_alive, self._on_gone, lose_all, calls.receive_reply, self._on_event, calls.tick
        )
        self._unsent_stop: str | None = None
        self._is_repeating_stop = False
        self._is_shaking_hands = False
        self._losses = 0
        self._log = get_logger(robot=self.name)

    # Life.

    @override
    def on_start(self) -> None:
        self._controller.add(self._listener)
        self.actor_inbox.call_later(self.clock.of_real(CONNECT_S), self._stop_waiting)
        self._ping_periodically()

    def _ping_periodically(self) -> None:
        """Measure the clock offset again, since clocks drift, and repair the list of running commands."""
        if self._channel.is_ready:
            self.ping()
        self.actor_inbox.call_later(self.clock.of_real(PING_PERIOD_S), self._ping_periodically)

    def _stop_waiting(self) -> None:
        if self.view.state is RobotState.STARTING:
            is_busy = REAL_TIME.now() - self._controller.last_handshake_s < CONNECT_S
            if is_busy and self._controller.is_alive(self.name):  # it may be one of a thousand
                self.actor_inbox.call_later(self.clock.of_real(CONNECT_S), self._stop_waiting)
                return
            self._note_lost(f"{self._controller.why_silent(self.name, self.address)}; the connection is retried")
        self.view.started.set(None)

    # Callbacks of the controller, in the readers' threads.

    def _on_alive(self, version: int) -> None:
        self._channel.run_soon(lambda: self._check_version(version))

    def _on_gone(self, reason: str) -> None:
        self._channel.run_soon(lambda: self._lose(reason))
        self._channel.lose_all()

    def _on_event(self, event: RobotEvent) -> None:
        if event.kind == "running":
            self._list(event.fields.get("running"), event.stamp_s)
        elif event.kind == "result" and event.call is not None:
            self._board.end(event.call, event.stamp_s)
            self.calls.receive_result(event)
        else:
            self._channel.run_soon(lambda: self._handle_robot_event(event))

    def _list(self, rows: object, as_of_s: float) -> None:
        """Replace the list of running commands, and report what ours have progressed."""
        for call_id, progress in self._board.replace(rows, as_of_s):
            self.calls.receive_progress(call_id, localized_progress(progress, self._to_fleet_time))

    def _handle_robot_event(self, event: RobotEvent) -> None:
        if event.kind == "state":
            self._log.info("robot's state", state=event.fields.get("state"))
            self._shake_hands()
        elif event.kind == "dead_man" and event.fields.get("client") == self._controller.client:
            self._log.warning("the robot has halted: it missed our heartbeats", resource=event.fields.get("resource"))

    # Handshake.

    def _check_version(self, version: int) -> None:
        try:
            check_version(version, "its heartbeat")
        except ProtocolError as error:
            self._note_lost(f"is incompatible: {error.message}")
            self.view.started.set(None)
        else:
            self._shake_hands()

    def _shake_hands(self) -> None:
        if self._is_shaking_hands or self.view.state is RobotState.STOPPED:
            return
        self._is_shaking_hands = True
        self.calls.begin_epoch()
        name = self._controller.display_name
        self._channel.request(keys.HELLO, (name,), _REQUEST_TIMEOUT_S, self._finish_handshake)

    def _retry_handshake(self) -> None:
        self.actor_inbox.call_later(self.clock.of_real(_HELLO_RETRY_S), self._shake_hands_if_alive)

    def _shake_hands_if_alive(self) -> None:
        if self._controller.is_alive(self.name) and self.view.state not in CONNECTED:
            self._shake_hands()

    def _finish_handshake(self, answer: Answer | None) -> None:
        self._is_shaking_hands = False
        if answer is None:
            self._retry_handshake()
            return
        try:
            handshake = Handshake.decode(answer, self._controller.certificate)
            if is_another := handshake.process != self._channel.process:
                self._board.clear()  # its clock may be another one
            self._list(handshake.running, -math.inf)
        except ProtocolError as error:
            self._note_lost(error.message)
            self._retry_handshake()
            return
        self._controller.last_handshake_s = REAL_TIME.now()
        self._channel.rights, self._channel.process = handshake.rights, handshake.process
        self._channel.memory.reset()
        if is_another or self.view.state not in CONNECTED:  # else its calls already take one way, and keep to it
            self._controller.local.connect(self.name, handshake.process, self.address)
        self.view.not_ready = dict(handshake.not_ready)
        self._update_cells(handshake)
        self._update_stop(handshake.stopped)
        self._note_connected(handshake)
        self.view.started.set(None)
        self.calls.tracker.reattach()
        self._feeds.renew()
        self.ping()  # measures the clock offset better than the handshake

    def _note_connected(self, handshake: Handshake) -> None:
        state = RobotState.FAILED if handshake.has_failed else RobotState.READY
        if self.view.state is state:
            return
        if handshake.has_failed:
            self._log.warning("robot has failed", reason="; ".join(handshake.problems[-1:]))
        else:
            self._log.info("robot is ready", address=self.address)
        self.view.state = state

    def _update_cells(self, handshake: Handshake) -> None:
        cells = dict(self.view.cells)
        for info in handshake.infos:
            cell = cells.get(info.name)
            if cell is None:
                keeper, latch = self._controller.timekeeper, self.view.latch
                cell = cells[info.name] = ResourceCell(
                    self.name, info.name, self.clock, keeper, self._timeout_s, self._link, latch
                )
                cell.open_feed = self._feeds.open
                cell.denied = partial(self._channel.denied, info.name)
            cell.info = info
            cell.actor = self.calls
        for name in cells.keys() - {info.name for info in handshake.infos}:
            cells[name].actor = None
            cells[name].error = UnavailableError("the robot no longer has it")
        self.view.cells = cells
        problems: list[EALError] = [UnavailableError(problem, robot=self.name) for problem in handshake.problems]
        if handshake.has_failed and problems:
            reason = problems[-1].message.removeprefix(f"{RobotFailedError.__name__}: {self.name}: ")
            problems[-1] = RobotFailedError(reason, robot=self.name)
        self.view.problems, self.view.left_out = tuple(problems), handshake.left_out

    def _update_stop(self, stopped: str | None) -> None:
        """Copy the robot's emergency stop; a stop that has not reached the robot is sent again."""
        if stopped is not None:
            self._unsent_stop = None
            self.view.latch.set(stopped)
            self.view.latch.confirm()
        elif self._unsent_stop is not None:
            self._send_stop(self._unsent_stop)
        else:
            self.view.latch.clear()

    def _lose(self, reason: str) -> None:
        if self.view.state in (*CONNECTED, RobotState.LOST):  # of two reasons the later one is right
            self._note_lost(f"{reason}; reconnecting")

    def _give_up_commands(self, losses: int) -> None:
        if self.view.state is RobotState.LOST and self._losses == losses:
            self.calls.tracker.give_up(f"the robot {self.view.problems[-1].message}")

    def _note_lost(self, reason: str) -> None:
        error = UnavailableError(reason, robot=self.name)
        if self.view.state is not RobotState.LOST:
            self._log.warning("robot is lost", reason=reason)
            self._losses += 1
            halted_s = 2 * self._controller.dead_man_s  # by then the robot, if it lives, has halted what we moved
            self.actor_inbox.call_later(self.clock.of_real(halted_s), partial(self._give_up_commands, self._losses))
        self._board.clear()
        self.view.problems = (error,)
        for cell in self.view.cells.values():
            cell.error = UnavailableError(f"the robot {reason}")
            cell.actor = None
        self._feeds.suspend()
        self.view.state = RobotState.LOST

    # Methods of RobotConnection, which describes them.

    def ping(self) -> Future[Ping]:
        """Measure the clock offset and return the robot's state."""

        def read(answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> Ping:
            ping = self._channel.clock_tracker.read_ping(answer, time, sent_s, answered_s)
            if isinstance(answer, dict):  # always true after read_ping
                self._list(answer.get("running", ()), answer["received_s"])
            self.view.not_ready = dict(ping.not_ready)
            state = self.view.state
            if ping.state is not state and RobotState.FAILED in (ping.state, state) and self._channel.is_ready:
                self._channel.run_soon(self._shake_hands)  # the event of its state was lost
            return replace(ping, running=self.running(), warnings=(*ping.warnings, *self._controller.warnings()))

        return self._channel.call(keys.PING, (), PING_TIMEOUT_S, read)

    def running(self) -> tuple[RunningCommand, ...]:
        """Return the running commands of all controllers."""
        return self._board.running(self._to_fleet_time)

    def _to_fleet_time(self, robot_s: float) -> float:
        """Return our fleet's time at a real time of the robot."""
        known = self._channel.clock_tracker.latest
        return self.clock.from_real(robot_s - (0.0 if known is None else known.offset_s))

    def stop_now(self, reason: str) -> Future[None]:
        """Stop the robot until it is resumed; repeated until the robot has confirmed it."""
        rights = self._channel.rights
        if rights is None or rights.allows(keys.ROBOT, keys.STOP):
            self.view.latch.set(reason)
            self._unsent_stop = reason
            self._channel.run_soon(self._repeat_stop_later)
        return self._send_stop(reason)

    def _send_stop(self, reason: str) -> Future[None]:
        def confirm(*_: object) -> None:
            self._unsent_stop = None
            self.view.latch.confirm()

        return self._channel.call(keys.STOP, (reason,), _REQUEST_TIMEOUT_S, confirm)

    def _repeat_stop_later(self) -> None:
        if not self._is_repeating_stop:
            self._is_repeating_stop = True
            self.actor_inbox.call_later(self.clock.of_real(_REQUEST_TIMEOUT_S), self._repeat_stop)

    def _repeat_stop(self) -> None:
        """Send a stop again that the robot has not confirmed: it may have been frozen, and yet never lost."""
        self._is_repeating_stop = False
        if self._unsent_stop is not None:
            if self._channel.is_ready:
                self._send_stop(self._unsent_stop)
            self._repeat_stop_later()

    def resume(self) -> Future[None]:
        """End an emergency stop."""

        def confirm(*_: object) -> None:
            self._unsent_stop = None
            self.view.latch.clear()

        return self._channel.call(keys.RESUME, (), _REQUEST_TIMEOUT_S, confirm)

    def release(self, resources: Sequence[str]) -> Future[None]:
        """End our leases of resources."""
        return self._channel.call(keys.RELEASE, tuple(resources), _REQUEST_TIMEOUT_S, lambda *_: None)

    def halt_before_end(self) -> None:
        """Leave the robot, which halts it."""
        self.shut_down()

    def shut_down(self) -> None:
        """Leave the robot, and end."""
        self._channel.run_soon(self._leave)

    def _leave(self) -> None:
        if self.view.state is RobotState.STOPPED:
            return
        was_connected = self.view.state in CONNECTED
        self.view.state = RobotState.STOPPED
        error = UnavailableError("the robot is disconnected")
        for cell in self.view.cells.values():
            cell.close(error)
        self.calls.close(error)
        if was_connected:
            self.actor_inbox.call_later(self.clock.of_real(_LEAVE_TIMEOUT_S), self._stop)
            self._channel.request(keys.LEAVE, (), _LEAVE_TIMEOUT_S, lambda _: self._stop())
        else:
            self._stop()

    def force_down(self) -> None:
        """End without leaving the robot."""
        self._channel.run_soon(self._stop)

    @override
    def on_stop(self) -> None:
        self._controller.remove(self._listener)
        self._feeds.close()
        self._channel.memory.close()
        self.calls.close(UnavailableError("the robot is disconnected"))
        self.view.state = RobotState.STOPPED
        self.view.started.set(None)
        self.view.stopped.set(None)

    @override
    def on_crash(self, error: BaseException) -> None:
        self._note_lost(f"is unreachable: its connection crashed: {error_text(error)}")
        self.on_stop()

    def is_at_work(self) -> bool:
        """Return whether the caller runs in this actor's thread."""
        return threading.current_thread() is self.thread

    def join(self, timeout_s: float) -> list[str]:
        """Wait for the thread; return its name if it is still alive."""
        thread = self.thread
        if thread is None or thread is threading.current_thread():
            return []
        with self.clock.outside():
            thread.join(max(0.0, timeout_s))
        return [thread.name] if thread.is_alive() else []
