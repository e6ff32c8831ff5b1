"""The actor of one robot connection: connects its plugins, starts and supervises its resources, stops it safely."""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from typing_extensions import override

from eal_actors.actors.actor import UNWIND_S, EALActor, halt_if_still_stuck
from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.resource_actor import ResourceActor, ResourceCallbacks
from eal_actors.actors.robot_view import Ping, RobotConnection, RobotState, RobotView, RunningCommand, release
from eal_actors.actors.supervision import Restart, RestartIntensity
from eal_actors.device.info import ResourceInfo
from eal_actors.device.link import FaultyLink
from eal_actors.device.plugin_context import OpenPlugins, crash_text
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import (
    EALError,
    NotReadyError,
    PluginError,
    RobotFailedError,
    UnavailableError,
    error_text,
)
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.unwinding import AbandonedThread

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """The specification of a robot.

    Attributes:
        open_plugins: connects the robot's plugins; runs in the robot's thread and may take long.
        timeout_s: the default deadline of a call, and the time a resource may take to start.
        max_restarts: restarts allowed within the window, for all resources together.
        link: the link that calls to its resources pass; a faultless one if None.
    """

    name: str
    clock: Clock
    open_plugins: Callable[[], OpenPlugins]
    timeout_s: float = 10.0
    mailbox: int = 256
    restart: Restart = Restart.PERMANENT
    max_restarts: int = 3
    restart_window_s: float = 5.0
    link: FaultyLink | None = None


HANG_GRACE_S: Final = 1.0
"""Fleet time that a call may run beyond its deadline before its resource counts as stuck."""
_SECOND_LOOK_S: Final = 0.25  # real time after which a resource that is late is looked at again before it is abandoned
_ROUNDING_S: Final = 1e-6


class RobotActor(EALActor, RobotConnection):
    """Supervises the resources of one robot, one for one, with back-off and a limit.

    Too many restarts within the window stop the whole robot safely and mark it failed: a robot whose motor driver
    keeps crashing must not continue.
    """

    is_remote = False

    def __init__(self, spec: RobotSpec, view: RobotView) -> None:
        super().__init__(spec.name, spec.clock)
        self.spec = spec
        self.view = view
        self._plugins: OpenPlugins | None = None
        self._children: dict[str, ResourceActor] = {}
        self._starting: set[str] = set()
        self._failed_opens = Counter[str]()  # in a row, by resource
        self._gone: set[str] = set()  # resources that have crashed, were halted by that, and are not restarted
        self._intensity = RestartIntensity(spec.max_restarts, spec.restart_window_s)
        self._callbacks = ResourceCallbacks(
            up=lambda actor, info: self.run_soon(lambda: self._on_up(actor, info)),
            ready=self._note_readiness,
            down=lambda actor, error: self.run_soon(lambda: self._on_down(actor, error)),
            watch=self._watch,
        )
        self._stopping = False
        self._stop_waits = False  # whether an emergency stop waits for the halt of a device that is absent
        self._threads: list[threading.Thread] = []
        self._log = get_logger(robot=spec.name)

    # Start.

    @override
    def on_start(self) -> None:
        """Connect the plugins and start the resources. Thread: the robot's own; may take long."""
        try:
            self._start()
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything: the robot fails, nothing else
            self._fail(RobotFailedError(f"could not start: {error_text(error)}", robot=self.spec.name))

    def _start(self) -> None:
        self._plugins = self.spec.open_plugins()
        self.view.problems, self.view.left_out = self._plugins.errors, self._plugins.left_out
        if self._plugins.errors and not self._plugins.resources:
            reasons = "; ".join(problem.message for problem in self._plugins.errors)
            self._fail(RobotFailedError(f"none of its plugins connected: {reasons}", robot=self.spec.name))
            return
        for problem in self._plugins.errors:
            self._log.error("plugin left out", reason=problem.message)
        spec, latch = self.spec, self.view.latch
        self.view.cells = {  # assigned whole, because other threads read it
            name: ResourceCell(spec.name, name, self.clock, self.actor_inbox, spec.timeout_s, spec.link, latch)
            for name in self._plugins.resources
        }
        self._starting = set(self.view.cells)
        for name in list(self.view.cells):
            self._spawn(name)
        self._ready_if_all_up()

    def _spawn(self, name: str) -> None:
        if self._stopping or self.view.state is RobotState.FAILED or self._plugins is None:
            return
        factory, cell = self._plugins.resources[name], self.view.cells[name]
        self._children[name] = actor = ResourceActor(cell, factory, self._callbacks, self.spec.mailbox).launch()
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        if actor.thread is not None:
            self._threads.append(actor.thread)

    # Reports of the children.

    def _on_up(self, actor: ResourceActor, info: ResourceInfo) -> None:
        name = actor.cell.name
        if self._children.get(name) is not actor:
            return
        actor.cell.info = info
        actor.cell.actor = actor
        actor.cell.serve_now = actor.serve_now if actor.any_thread else None  # it may be closed by now
        actor.cell.read_now = actor.serve_now if actor.glances else None
        self._starting.discard(name)
        self._log.debug("resource is up", resource=name)
        self._ready_if_all_up()
        self._stop_again()

    def _ready_if_all_up(self) -> None:
        if not self._starting and self.view.state is RobotState.STARTING and not self._stopping:
            self.view.state = RobotState.READY
            self.view.started.set(None)

    def _on_down(self, actor: ResourceActor, error: BaseException | None) -> None:
        name = actor.cell.name
        if self._children.get(name) is not actor:
            return
        del self._children[name]
        actor.cell.actor = actor.cell.serve_now = actor.cell.read_now = None
        self.view.not_ready.pop(name, None)  # it is worse than not ready: calls fail with the reason
        if self._stopping:
            if not self._children:
                self._stop()
            return
        if self.view.state is RobotState.FAILED:
            return
        self._failed_opens[name] = 0 if actor.is_up else self._failed_opens[name] + 1
        self._restart(name, error)

    def _restart(self, name: str, error: BaseException | None) -> None:
        cell, restart = self.view.cells[name], self.spec.restart
        if isinstance(error, UnavailableError):
            reason = error.message
        else:
            reason = f"crashed with {crash_text(error)}" if error is not None else "ended"
        if isinstance(error, PluginError):  # an error in the plugin's code: another try cannot help
            self._fail(RobotFailedError(f"{name} {reason}", robot=self.spec.name))
            return
        if not restart.applies(crashed=error is not None):
            cell.error = UnavailableError(f"{reason}; it is not restarted ({restart.value})")
            self._log.error("resource is gone", resource=name, reason=reason)
            self._starting.discard(name)
            if not isinstance(error, UnavailableError):  # a stuck one may still move
                self._gone.add(name)
                self._stop_again()
            self._ready_if_all_up()
            return
        if (delay_s := self._intensity.next_delay_s(self.clock.now())) is None:
            limit = f"more than {self._intensity.max_restarts} restarts in {self._intensity.window_s:g} s"
            self._fail(RobotFailedError(f"stopped safely after {limit}; last, {name} {reason}", robot=self.spec.name))
            return
        if (count := self._failed_opens[name]) > self._intensity.max_restarts:  # each may have left a stuck thread
            message = f"could not start: {name} did not open {count} times in a row; last, it {reason}"
            self._fail(RobotFailedError(message, robot=self.spec.name))
            return
        cell.error = UnavailableError(f"is restarting: it {reason}")
        self.view.restarts[name] = self.view.restarts.get(name, 0) + 1
        self._log.warning("resource restarts", resource=name, reason=reason, delay_s=delay_s)
        self.actor_inbox.call_later(delay_s, lambda: self._spawn(name))

    # Stuck resources.

    def _watch(self, actor: ResourceActor, until_s: float) -> None:
        self.actor_inbox.call_at(until_s + HANG_GRACE_S, lambda: self._abandon_if_stuck(actor))

    def _abandon_if_stuck(self, actor: ResourceActor, overdue_since_s: float | None = None) -> None:
        if self._children.get(actor.cell.name) is not actor:
            return
        actor.watched_until_s = math.inf  # first, so that a step that begins from here on asks for another check
        if (busy_until_s := actor.busy_until_s) is None:
            return
        overdue_s = self.clock.now() - busy_until_s
        if overdue_s < HANG_GRACE_S - _ROUNDING_S:  # within its time: check again when that is over
            actor.watched_until_s = busy_until_s
            self._watch(actor, busy_until_s)
        elif overdue_since_s != busy_until_s:  # the whole process may have stood still: let the thread run first
            again_s = self.clock.of_real(_SECOND_LOOK_S)
            self.actor_inbox.call_later(again_s, lambda: self._abandon_if_stuck(actor, busy_until_s))
        elif actor.is_up:
            self._abandon(actor, f"was stuck for {overdue_s:.1f} s beyond its deadline")
        else:
            self._abandon(actor, f"did not open within its {actor.cell.timeout_s:g} s")

    def _abandon(self, actor: ResourceActor, why: str) -> None:
        error = UnavailableError(f"{why}; it has been abandoned")
        self._log.error("resource is stuck", resource=actor.cell.name, reason=why)
        resource = actor.resource
        actor.abandon(error)
        if resource is not None:
            rescue = threading.Thread(
                target=halt_if_still_stuck, args=(actor, resource.halt), name=f"{actor.name} halt", daemon=True
            )
            rescue.start()
            self._threads.append(rescue)
        self._on_down(actor, error)

    # RobotConnection.

    @override
    def ping(self) -> Future[Ping]:
        """Answer at once, whatever the robot does."""
        view = self.view
        about, not_ready = (view.state, release(), len(view.cells), view.latch.emergency), dict(view.not_ready)
        return self._done(Ping(*about, not_ready=not_ready, running=self.running()))

    @override
    def running(self) -> tuple[RunningCommand, ...]:
        return tuple(command for actor in list(self._children.values()) for command in actor.running())

    @override
    def stop_now(self, reason: str) -> Future[None]:
        self.view.latch.set(reason)
        halts = []
        for name, cell in self.view.cells.items():
            if name not in self._gone:
                halts.append(halt := Call[Any](cell, "halt", (), cell.timeout_s))
                cell.submit_urgent(halt, stops=True)
        return gather(halts).map(lambda _: self._confirm_stop())

    def _stop_again(self) -> None:
        """Repeat an emergency stop that is not confirmed, because a resource was not there to be halted."""
        if (reason := self.view.latch.reason) is not None and not self.view.latch.is_confirmed:
            self.stop_now(reason)

    def _confirm_stop(self) -> None:
        """Record that the robot has halted, or raise NotReadyError if a halt waits for a device that is absent."""
        owing = [name for name, cell in self.view.cells.items() if cell.owes_halt]
        self._stop_waits = bool(owing)
        if owing:
            raise NotReadyError(f"{', '.join(owing)} cannot be halted before the device is back", robot=self.view.name)
        self.view.latch.confirm()

    def _note_readiness(self, actor: ResourceActor, reason: str | None) -> None:
        self.view.note_readiness(actor.cell.name, reason)
        if self._stop_waits and not any(cell.owes_halt for cell in self.view.cells.values()):
            self._stop_waits = False
            self.view.latch.confirm()

    @override
    def resume(self) -> Future[None]:
        self.view.latch.clear()
        return self._done(None)

    @override
    def release(self, _: Sequence[str]) -> Future[None]:
        """Do nothing: within a process no controller holds a resource against others."""
        return self._done(None)

    def _done(self, value: T) -> Future[T]:
        done: Future[T] = Future(self.clock)
        done.set(value)
        return done

    # The end.

    def _fail(self, error: RobotFailedError) -> None:
        self._log.error("robot has failed", reason=error.message)
        self.view.problems = (*self.view.problems, error)
        self.view.state = RobotState.FAILED  # after its reason, which observers of the state read
        self._shut_down_children(error)
        self.view.started.set(None)

    def _shut_down_children(self, error: EALError) -> None:
        for cell in self.view.cells.values():
            cell.close(error)
        for actor in self._children.values():
            actor.shut_down()

    @override
    def halt_before_end(self) -> None:
        for actor in list(self._children.values()):
            actor.halt_soon()

    @override
    def shut_down(self) -> None:
        self.run_soon(self._shut_down)

    def _shut_down(self) -> None:
        if self._stopping:
            return
        self._stopping = True
        self._shut_down_children(UnavailableError("the robot is disconnected"))
        if not self._children:
            self._stop()

    @override
    def force_down(self) -> None:
        self.run_soon(self._force_down)

    def _force_down(self) -> None:
        self._stopping = True
        for actor in list(self._children.values()):
            self._abandon(actor, "did not stop in time")

    @override
    def on_stop(self) -> None:
        """Disconnect the plugins and publish the end. Thread: the robot's own."""
        if self._children:  # stopped from outside, by Pykka
            self._stopping = True
            self._shut_down_children(UnavailableError("the robot was stopped"))
            self.join(UNWIND_S)
        self._close_plugins()
        if self.view.state is not RobotState.FAILED:
            self.view.state = RobotState.STOPPED
        self.view.started.set(None)
        self.view.stopped.set(None)

    def _close_plugins(self) -> None:
        plugins, self._plugins = self._plugins, None
        if plugins is not None:
            try:
                plugins.close()
            except Exception as error:  # noqa: BLE001  # a plugin may raise anything, and the robot must end
                self._log.error("cleaning up failed", error=error_text(error))

    @override
    def abandon(self, error: EALError) -> None:
        """Stop the resources all the same; see EALActor."""
        for actor in list(self._children.values()):
            actor.shut_down()
        super().abandon(error)

    @override
    def is_at_work(self) -> bool:
        return threading.current_thread() in (self.thread, *self._threads)

    @override
    def on_crash(self, error: BaseException) -> None:
        """Fail, which stops the resources. Thread: the robot's own."""
        self._fail(RobotFailedError(f"its own actor crashed: {error_text(error)}", robot=self.spec.name))
        self.on_stop()

    @override
    def join(self, timeout_s: float) -> list[str]:
        end_s = REAL_TIME.now() + timeout_s
        threads = [*self._threads, *([self.thread] if self.thread is not None else [])]
        threads = [thread for thread in threads if thread is not threading.current_thread()]
        with self.clock.outside():
            for thread in threads:
                thread.join(max(0.0, end_s - REAL_TIME.now()))
        return [thread.name for thread in threads if thread.is_alive()]


def start_robot(spec: RobotSpec) -> tuple[RobotActor, RobotView]:
    """Start a robot's actor; its view's `started` is done when it is up. Thread: any; does not block."""
    view = RobotView(spec.name, spec.clock)
    return RobotActor(spec, view).launch(), view
