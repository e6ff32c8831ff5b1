"""OrderDriver: carries out the nodes and actions of one vehicle's order on its robot, one after the other."""

from __future__ import annotations

import time
from typing import Any, Final

from eal_actors import EALData, EALError, Future, RobotHandle
from eal_actors.plugin import get_logger

from .messages import AgvAction, Node
from .order_book import OrderBook
from .vehicle_report import VehicleReport

BASE: Final = "Base"
_DRIVE_S: Final = 3600.0
"""Deadline of the way to a node."""
_CONFIG_S: Final = 5.0
_HALT_AGAIN_S: Final = 1.0


class OrderDriver:
    """Drives to nodes with `goto`, under the robot's lease, which is released when the order is over.

    Args:
        report: receives errors and action states.
    """

    def __init__(self, robot: RobotHandle, book: OrderBook, report: VehicleReport) -> None:
        self._robot = robot
        self._book = book
        self._report = report
        self._log = get_logger(robot=robot.name)
        self._driving: tuple[Node, Future[Any]] | None = None
        self._working: tuple[AgvAction, Future[Any]] | None = None
        self._waiting: list[AgvAction] = []
        self._usual: Future[EALData] | None = None
        self._limit: tuple[float, Future[int]] | None = None
        self._restoring: Future[int] | None = None
        self._halting: Future[int] | None = None
        self._halt_again_s = 0.0

    @property
    def is_driving(self) -> bool:
        """Whether the robot is on its way to a node, its base carries out an action, or it has not confirmed a halt."""
        is_at_base = self._working is not None and self._working[0].parameters()["resource"] == BASE
        return self._driving is not None or is_at_base or self.is_halting

    @property
    def is_halting(self) -> bool:
        """Whether the robot has not confirmed a halt."""
        return self._halting is not None

    @property
    def is_busy(self) -> bool:
        """Whether it drives or works."""
        return self._driving is not None or self._working is not None

    @property
    def has_order(self) -> bool:
        """Whether nodes or actions are left."""
        return bool(self._book.nodes or self._waiting) or self.is_busy

    def go_on(self, *, is_held: bool, is_placed: bool) -> None:
        """Hear of what is over, and begin the next node or action unless held; a robot is placed if it has a pose."""
        self._hear_of_node()
        self._hear_of_action()
        if not self._is_halted() or not self._is_restored() or is_held or self.is_busy:
            return
        if self._waiting:
            self._begin_action(self._waiting.pop(0))
        elif (node := self._book.next_node()) is not None:
            self._drive_to(node, is_placed=is_placed)

    def stop(self) -> Future[int]:
        """Halt the robot, again and again until it confirms it; the node is to be reached all the same.

        Returns the outcome of the first halt.
        """
        self._driving, self._halt_again_s = None, time.perf_counter() + _HALT_AGAIN_S
        try:
            self._halting = self._robot[BASE].halt()
        except EALError as error:  # a reload starts the robot anew
            self._halting = Future()
            self._halting.fail(error)
        return self._halting

    def cancel(self) -> Future[int]:
        """Forget the order, and halt the robot; see `stop`."""
        halting = self.stop()
        if self._working is not None:
            self._waiting.append(self._working[0])
            self._working[1].cancel()
        for action in (*self._waiting, *self._book.cancel()):
            self._report.set_action(action, "FAILED", "cancelled")
        self._waiting, self._working = [], None
        self._let_go()
        return halting

    def _drive_to(self, node: Node, *, is_placed: bool) -> None:
        position, edge = node.node_position, self._book.edge_to(node)
        if position is None:  # the book refuses such nodes
            return
        base = self._robot[BASE]
        if edge is None and is_placed and position.theta is None:  # the first node: it is there
            self._pass(node)
            return
        if edge is not None and edge.max_speed is not None and not self._is_limited(node, edge.max_speed):
            return
        goal = [position.x, position.y] if position.theta is None else [position.x, position.y, position.theta]
        self._driving = node, base.send_cmd("goto", goal, timeout_s=_DRIVE_S)
        self._report.is_due = True

    def _is_limited(self, node: Node, most_m_s: float) -> bool:
        """Return whether the robot is at most that fast; other vehicles do not wait for it."""
        base = self._robot[BASE]
        if self._usual is None:
            self._usual = base.get_config("speed_m_s", timeout_s=_CONFIG_S)
        if not self._usual.done():
            return False
        try:
            wanted_m_s = min(float(self._usual.get().value), most_m_s)
            if self._limit is None or self._limit[0] != wanted_m_s:
                self._limit = wanted_m_s, base.set_config("speed_m_s", wanted_m_s, timeout_s=_CONFIG_S)
            if self._limit[1].done():
                self._limit[1].get()
                return True
        except EALError as error:
            self._limit = None
            if self._usual.exception() is not None:
                self._usual = None
            self._fail(node, error)
        return False

    def _hear_of_node(self) -> None:
        if self._driving is None or not self._driving[1].done():
            return
        (node, driving), self._driving = self._driving, None
        self._report.is_due = True
        error = driving.exception()
        if error is None:
            self._pass(node)
        else:
            self._fail(node, error)

    def _fail(self, node: Node, error: BaseException) -> None:
        ids = {"orderId": self._book.order_id, "nodeId": node.node_id}
        self._report.add("drivingError", str(error), level="FATAL", **ids)

    def _pass(self, node: Node) -> None:
        self._book.passed(node)
        self._waiting += node.actions
        self._report.is_due = True
        self._let_go_at_end()

    def _begin_action(self, action: AgvAction) -> None:
        wanted = action.parameters()
        try:
            resource, command = str(wanted["resource"]), str(wanted["command"])
            if resource not in self._robot:
                raise KeyError(resource)
        except KeyError as error:
            self._report.set_action(action, "FAILED", f"there is no {error}")
            self._report.add("actionError", f"there is no {error}", level="FATAL", actionId=action.action_id)
            return
        self._report.set_action(action, "RUNNING")
        self._working = action, self._robot[resource].send_cmd(command, timeout_s=_DRIVE_S)

    def _hear_of_action(self) -> None:
        if self._working is None or not self._working[1].done():
            return
        (action, answer), self._working = self._working, None
        error = answer.exception()
        result = str(answer.get() if error is None else error)
        self._report.set_action(action, "FINISHED" if error is None else "FAILED", result)
        if error is not None:
            self._report.add("actionError", str(error), level="FATAL", actionId=action.action_id)
        else:
            self._let_go_at_end()

    def _let_go_at_end(self) -> None:
        if not self._book.nodes and not self._waiting:
            self._let_go()

    def _let_go(self) -> None:
        """Restore the usual speed, and release the robot for other controllers."""
        usual, self._usual, self._limit = self._usual, None, None
        if usual is None or not usual.done() or usual.exception() is not None:
            self._robot.release()
        else:
            self._restoring = self._robot[BASE].set_config("speed_m_s", usual.get().value, timeout_s=_CONFIG_S)

    def _is_halted(self) -> bool:
        """Return whether the robot has confirmed the last halt; repeat one that did not reach it."""
        if self._halting is not None and self._halting.done():
            if self._halting.exception() is None:
                self._halting, self._report.is_due = None, True
            elif time.perf_counter() >= self._halt_again_s:
                self.stop()
        return self._halting is None

    def _is_restored(self) -> bool:
        """Return whether nothing is left of the last order; release the robot once its speed is restored."""
        if self._restoring is not None and self._restoring.done():
            if (error := self._restoring.exception()) is not None:
                self._log.warning("its usual speed is not restored", reason=str(error))
            self._restoring = None
            self._robot.release()
        return self._restoring is None
