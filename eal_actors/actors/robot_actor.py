"""The actor of one robot connection: connects its plugins, starts and supervises its resources, stops it safely."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

from eal_actors.actors.actor import AbandonedThread, EALActor
from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.resource_actor import ResourceActor
from eal_actors.actors.resource_factory import ResourceFactory
from eal_actors.actors.robot_spec import OpenPlugins, RobotSpec
from eal_actors.actors.robot_view import Ping, RobotState, RobotView, release
from eal_actors.actors.running import Running
from eal_actors.actors.supervision import ChildSpec, RestartIntensity, wants_restart
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, PluginError, RobotFailedError, UnavailableError, shown
from eal_actors.kernel.log import get_logger

HANG_GRACE_S: Final = 1.0
"""How long after its deadline a call may still run before its resource counts as stuck, in fleet time."""
_ROUNDING_S: Final = 1e-6
"""Of a difference of times."""
_UNWIND_S: Final = 0.5
"""How long (real time) an abandoned thread has to unwind before somebody else halts its resource."""


class RobotActor(EALActor):
    """Supervises the resources of one robot: one for one, with back-off, and an end.

    Too many restarts within the window stop the whole robot safely and mark it failed: a robot whose motor driver
    keeps crashing must not go on.

    Args:
        spec: the robot.
        view: where it tells everybody how it is.
    """

    is_remote = False

    def __init__(self, spec: RobotSpec, view: RobotView) -> None:
        super().__init__(spec.name, spec.clock)
        self.spec = spec
        self.view = view
        self._plugins: OpenPlugins | None = None
        self._specs: dict[str, ChildSpec[ResourceActor]] = {}
        self._children: dict[str, ResourceActor] = {}
        self._starting: set[str] = set()
        self._intensity = RestartIntensity(spec.max_restarts, spec.restart_window_s)
        self._stopping = False
        self._threads: list[threading.Thread] = []
        self._log = get_logger(robot=spec.name)

    # Start.

    def on_start(self) -> None:
        """Connect the plugins and start the resources. Thread: the robot's own; may take long."""
        try:
            self._start()
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # whatever a plugin does: the robot fails, nothing else
            self._fail(RobotFailedError(f"could not start: {shown(error)}", robot=self.spec.name))

    def _start(self) -> None:
        self._plugins = self.spec.open_plugins()
        self.view.problems = self._plugins.errors
        if self._plugins.errors and not self._plugins.resources:
            reasons = "; ".join(problem.message for problem in self._plugins.errors)
            self._fail(RobotFailedError(f"none of its plugins connected: {reasons}", robot=self.spec.name))
            return
        for problem in self._plugins.errors:
            self._log.error("plugin left out", reason=problem.message)
        spec, latch = self.spec, self.view.latch
        cells = {
            name: ResourceCell(spec.name, name, self.clock, self.actor_inbox, spec.timeout_s, spec.link, latch)
            for name in self._plugins.resources
        }
        for name, factory in self._plugins.resources.items():
            start = partial(self._launch, cells[name], factory)
            self._specs[name] = ChildSpec(name, start, self.spec.restart)
        self.view.cells = cells  # whole, because others read it
        self._starting = set(self._specs)
        for name in list(self._specs):
            self._spawn(name)
        self._ready_if_all_up()

    def _launch(self, cell: ResourceCell, factory: ResourceFactory) -> ResourceActor:
        return ResourceActor(cell, factory, self, self.spec.mailbox).launch()

    def _spawn(self, name: str) -> None:
        if self._stopping or self.view.state is RobotState.FAILED:
            return
        self._children[name] = actor = self._specs[name].start()
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        if actor.thread is not None:
            self._threads.append(actor.thread)

    # What the children tell, in their own threads.

    def resource_up(self, actor: ResourceActor, info: ResourceInfo) -> None:
        """See ResourceObserver."""
        self._later(lambda: self._on_up(actor, info))

    def resource_ready(self, actor: ResourceActor, reason: str | None) -> None:
        """See ResourceObserver."""
        self.view.note_readiness(actor.cell.name, reason)

    def resource_down(self, actor: ResourceActor, error: BaseException | None) -> None:
        """See ResourceObserver."""
        self._later(lambda: self._on_down(actor, error))

    def _later(self, action: Callable[[], None]) -> None:
        with contextlib.suppress(EALError):  # the robot has ended: nobody is left to be told
            self.actor_inbox.call_soon(action)

    def _on_up(self, actor: ResourceActor, info: ResourceInfo) -> None:
        name = actor.cell.name
        if self._children.get(name) is not actor:
            return
        actor.cell.info = info
        actor.cell.actor = actor
        self._starting.discard(name)
        self._log.debug("resource is up", resource=name)
        self._ready_if_all_up()

    def _ready_if_all_up(self) -> None:
        if not self._starting and self.view.state is RobotState.STARTING and not self._stopping:
            self.view.state = RobotState.READY
            self.view.started.set(None)

    def _on_down(self, actor: ResourceActor, error: BaseException | None) -> None:
        name = actor.cell.name
        if self._children.get(name) is not actor:
            return
        del self._children[name]
        actor.cell.actor = None
        self.view.note_readiness(name, None)  # it is more than not ready: the calls say what it is
        if self._stopping:
            if not self._children:
                self._stop()
            return
        if self.view.state is RobotState.FAILED:
            return
        self._restart(name, error)

    def _restart(self, name: str, error: BaseException | None) -> None:
        cell, spec = self.view.cells[name], self._specs[name]
        if isinstance(error, UnavailableError):
            reason = error.message
        else:
            reason = f"crashed with {shown(error)}" if error is not None else "ended"
        if isinstance(error, PluginError):  # a fault of the plugin's code: trying again does not mend it
            self._fail(RobotFailedError(f"{name} {reason}", robot=self.spec.name))
            return
        if not wants_restart(spec.restart, crashed=error is not None):
            cell.error = UnavailableError(f"{reason}; it is not restarted ({spec.restart.value})")
            self._log.error("resource is gone", resource=name, reason=reason)
            self._starting.discard(name)
            self._ready_if_all_up()
            return
        delay_s = self._intensity.next_delay_s(self.clock.now())
        if delay_s is None:
            limit = f"more than {self._intensity.max_restarts} restarts in {self._intensity.window_s:g} s"
            self._fail(RobotFailedError(f"stopped safely after {limit}; last, {name} {reason}", robot=self.spec.name))
            return
        cell.error = UnavailableError(f"is restarting: it {reason}")
        self.view.restarts[name] = self.view.restarts.get(name, 0) + 1
        self._log.warning("resource restarts", resource=name, reason=reason, delay_s=delay_s)
        self.actor_inbox.call_later(delay_s, lambda: self._spawn(name))

    # Stuck resources.

    def watch(self, actor: ResourceActor, until_s: float) -> None:
        """See ResourceObserver."""
        self.actor_inbox.call_at(until_s + HANG_GRACE_S, lambda: self._abandon_if_stuck(actor))

    def _abandon_if_stuck(self, actor: ResourceActor) -> None:
        if self._children.get(actor.cell.name) is not actor:
            return
        actor.watched_until_s = math.inf  # first, so that what begins from here on asks for another look
        busy_until_s = actor.busy_until_s
        if busy_until_s is None:
            return
        overdue_s = self.clock.now() - busy_until_s
        if overdue_s < HANG_GRACE_S - _ROUNDING_S:  # within its time: look again when that is over
            actor.watched_until_s = busy_until_s
            self.watch(actor, busy_until_s)
        else:
            self._abandon(actor, f"was stuck for {overdue_s:.1f} s beyond its deadline")

    def _abandon(self, actor: ResourceActor, why: str) -> None:
        error = UnavailableError(f"{why}; it has been abandoned")
        self._log.error("resource is stuck", resource=actor.cell.name, reason=why)
        resource = actor.resource
        actor.abandon(error)
        if resource is not None:
            watch = threading.Thread(
                target=_halt_if_still_stuck, args=(actor, resource.halt), name=f"{actor.name} halt", daemon=True
            )
            watch.start()
            self._threads.append(watch)
        self._on_down(actor, error)

    # What everybody may ask.

    def ping(self) -> Future[Ping]:
        """See RobotConnection: answered at once, whatever the robot does."""
        future: Future[Ping] = Future()
        view, not_ready = self.view, dict(self.view.not_ready)
        future.set(
            Ping(
                view.state,
                release(),
                len(view.cells),
                view.latch.reason,
                not_ready=not_ready,
                running=self.running(),
            )
        )
        return future

    def running(self) -> tuple[Running, ...]:
        """See RobotConnection."""
        return tuple(running for actor in list(self._children.values()) for running in actor.running())

    # Emergency stop.

    def stop_now(self, reason: str) -> Future[None]:
        """See RobotConnection."""
        self.view.latch.set(reason)
        halts = []
        for cell in self.view.cells.values():
            halts.append(halt := Call[Any](cell, "halt", (), cell.timeout_s))
            cell.submit_urgent(halt, stops=True)
        return gather(halts).map(lambda _: None)

    def resume(self) -> Future[None]:
        """See RobotConnection."""
        self.view.latch.clear()
        return self._done()

    def release(self, _: Sequence[str]) -> Future[None]:
        """See RobotConnection: within a process nobody holds a resource against others."""
        return self._done()

    def _done(self) -> Future[None]:
        done: Future[None] = Future(self.clock)
        done.set(None)
        return done

    # The end.

    def _fail(self, error: RobotFailedError) -> None:
        self._log.error("robot has failed", reason=error.message)
        self.view.state = RobotState.FAILED
        self.view.problems = (*self.view.problems, error)
        self._shut_down_children(error)
        self.view.started.set(None)

    def _shut_down_children(self, error: EALError) -> None:
        for cell in self.view.cells.values():
            cell.close(error)
        for actor in self._children.values():
            actor.shut_down()

    def shut_down(self) -> None:
        """Stop every resource safely, disconnect the plugins, and end. Thread: any; does not block."""
        self._later(self._shut_down)

    def _shut_down(self) -> None:
        if self._stopping:
            return
        self._stopping = True
        self._shut_down_children(UnavailableError("the robot is disconnected"))
        if not self._children:
            self._stop()

    def force_down(self) -> None:
        """Abandon whatever has not stopped by itself. Thread: any; does not block."""
        self._later(self._force_down)

    def _force_down(self) -> None:
        self._stopping = True
        for actor in list(self._children.values()):
            self._abandon(actor, "did not stop in time")

    def on_stop(self) -> None:
        """Disconnect the plugins, and tell everybody. Thread: the robot's own."""
        if self._children:  # stopped from outside, by Pykka
            self._stopping = True
            self._shut_down_children(UnavailableError("the robot was stopped"))
            self.join(_UNWIND_S)
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
            except Exception:  # noqa: BLE001  # a plugin may raise anything, and the robot must end
                self._log.exception("disconnecting the plugins failed")

    def abandon(self, error: EALError) -> None:
        """Stop the resources all the same; see EALActor."""
        for actor in list(self._children.values()):
            actor.shut_down()
        super().abandon(error)

    def is_at_work(self) -> bool:
        """Return whether the caller runs in a thread of this robot, which cannot wait for its own end."""
        return threading.current_thread() in (self.thread, *self._threads)

    def on_crash(self, error: BaseException) -> None:
        """Fail: a robot actor that crashes stops its resources. Thread: the robot's own."""
        self._fail(RobotFailedError(f"its own actor crashed: {shown(error)}", robot=self.spec.name))
        self.on_stop()

    def join(self, timeout_s: float) -> list[str]:
        """Wait (real time) for the robot's threads; return the names of those still alive. Thread: blocks it."""
        end_s = REAL_TIME.now() + timeout_s
        threads = [*self._threads, *([self.thread] if self.thread is not None else [])]
        threads = [thread for thread in threads if thread is not threading.current_thread()]
        with self.clock.outside():
            for thread in threads:
                thread.join(max(0.0, end_s - REAL_TIME.now()))
        return [thread.name for thread in threads if thread.is_alive()]


def _halt_if_still_stuck(actor: ResourceActor, halt: Callable[[], Any]) -> None:
    """Halt a resource whose own thread cannot: better from a foreign thread than not at all."""
    if actor.thread is not None:
        actor.thread.join(_UNWIND_S)
        if actor.thread.is_alive():
            try:
                halt()
            except Exception:  # noqa: BLE001  # a plugin may raise anything
                get_logger(robot=actor.cell.robot, resource=actor.cell.name).exception("last-resort halt failed")


def start_robot(spec: RobotSpec) -> tuple[RobotActor, RobotView]:
    """Start a robot's actor; its view's `started` tells when it is up. Thread: any; does not block."""
    view = RobotView(spec.name, spec.clock)
    return RobotActor(spec, view).launch(), view
