"""Vehicle: one robot of the fleet as an AGV of another master.

Orders are driven node by node with `goto`, under the robot's lease, which is released when the order is over. When the
broker is lost, the vehicle drives on to the last released node, as the standard demands.

Thread: one at a time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from eal_actors import EALData, EALError, Future, RobotHandle
from eal_actors.plugin import Clock, DataError, get_logger

from ..mqtt.connection import MqttConnection, MqttMessage, TopicInbox
from ..mqtt.plugin import client_name
from .factsheet import ACTIONS, factsheet
from .messages import (
    ActionState,
    AgvAction,
    AgvError,
    AgvPosition,
    AgvState,
    BatteryState,
    Connection,
    Headers,
    InstantActions,
    Node,
    Order,
    Part,
    Reference,
    SafetyState,
    Visualization,
    decode,
    encode,
)
from .order_book import OrderBook
from .settings import BridgeSettings

BASE: Final = "Base"
_DRIVE_S: Final = 3600.0
"""Deadline of the way to a node."""
_CONFIG_S: Final = 5.0
_MOST_ACTIONS: Final = 50
"""Actions that are over and still reported."""
_UNKNOWN_CHARGE: Final = 80.0
"""The standard's value for a battery that is good, of a robot that does not measure it."""
_DEPTH: Final = 16


class FleetVehicle:
    """One robot as an AGV.

    Args:
        robot: the robot.
        settings: of the bridge.
        clock: the fleet's clock.
    """

    def __init__(self, robot: RobotHandle, settings: BridgeSettings, clock: Clock) -> None:
        self._robot = robot
        self._settings = settings
        self._log = get_logger(robot=robot.name)
        self._prefix = f"{settings.interface}/v2/{settings.manufacturer}/{robot.name}"
        self._headers = Headers(settings.manufacturer, robot.name)
        self._connection = MqttConnection(
            settings, clock, client_name(robot.name), self._presence("CONNECTIONBROKEN"), self._greet
        )
        self._orders = self._connection.subscribe(f"{self._prefix}/order", depth=_DEPTH)
        self._instant = self._connection.subscribe(f"{self._prefix}/instantActions", depth=_DEPTH)
        self._book = OrderBook(settings.map_id, ACTIONS)
        self._pose: tuple[float, float, float] | None = None
        self._charge = _UNKNOWN_CHARGE
        self._is_paused = False
        self._is_greeted = False
        self._driving: Future[Any] | None = None
        self._goal: Node | None = None
        self._working: tuple[AgvAction, Future[Any]] | None = None
        self._waiting: list[AgvAction] = []
        self._actions: dict[str, ActionState] = {}
        self._errors: list[AgvError] = []
        self._usual_m_s: float | None = None
        self._state_due_s = 0.0
        self._pose_due_s = 0.0
        self._connection.open()

    # What others give it.

    def take_value(self, name: str, data: EALData) -> None:
        """Keep a sampled value. Thread: the sampler's."""
        if name == "Pose":
            x_m, y_m, yaw_rad = map(float, data.value)
            self._pose = x_m, y_m, yaw_rad
        else:
            self._charge = 100.0 * float(data.value)

    def step(self) -> None:
        """Take messages, go on with the order, and publish what has changed."""
        try:
            self._take(self._instant, InstantActions, self._act)
            self._take(self._orders, Order, self._accept)
            self._go_on()
        except EALError as error:
            self._log.warning("the vehicle cannot go on", reason=error.message)
        self._publish()

    def fail(self) -> None:
        """Halt the robot after a failure of this program; the order stays until it is cancelled."""
        self._stop()
        self._report("internalError", "the bridge failed; see its log", level="FATAL")

    def close(self) -> None:
        """Halt the robot if it drives, and say farewell."""
        if self._driving is not None or self._working is not None:
            self._stop()
        self._connection.close(self._presence("OFFLINE"))

    def why_not_ready(self) -> str | None:
        """Return why the broker is out of reach; None if it is not."""
        return self._connection.why_not_ready()

    # Orders.

    def _take(self, inbox: TopicInbox, kind: Any, use: Callable[[Any], None]) -> None:
        while True:
            try:
                received = inbox.take()
                if received is None:
                    return
                message = decode(kind, received.payload)
            except DataError as error:
                self._report("validationError", error.message)
            else:
                use(message)

    def _accept(self, order: Order) -> None:
        place = None if self._pose is None else self._pose[:2]
        refusal = self._book.receive(order, place)
        if refusal is not None:
            self._errors = [*self._errors[-9:], refusal]
        else:
            self._errors = []
            for action in (action for node in order.nodes for action in node.actions):
                self._actions.setdefault(action.action_id, _state(action, "WAITING"))
        self._state_due_s = 0.0

    def _go_on(self) -> None:
        if self._driving is not None and self._driving.done():
            self._arrive()
        if self._working is not None and self._working[1].done():
            self._end_action()
        is_held = self._is_paused or any(error.error_level == "FATAL" for error in self._errors)
        if is_held or self._driving is not None or self._working is not None:
            return
        if self._waiting:
            self._begin_action(self._waiting.pop(0))
        elif (node := self._book.next_node()) is not None:
            self._drive_to(node)

    def _drive_to(self, node: Node) -> None:
        position, edge = node.node_position, self._book.edge_to(node)
        if position is None:  # the book refuses such nodes
            return
        base = self._robot[BASE]
        if edge is None and self._pose is not None and position.theta is None:  # the first node: it is there
            self._pass(node)
            return
        if edge is not None and edge.max_speed is not None:
            if self._usual_m_s is None:
                self._usual_m_s = float(base.get_config("speed_m_s", timeout_s=_CONFIG_S).get().value)
            base.set_config("speed_m_s", min(self._usual_m_s, edge.max_speed))
        goal = [position.x, position.y] if position.theta is None else [position.x, position.y, position.theta]
        self._goal, self._driving = node, base.send_cmd("goto", goal, timeout_s=_DRIVE_S)
        self._state_due_s = 0.0

    def _arrive(self) -> None:
        driving, node = self._driving, self._goal
        self._driving = self._goal = None
        self._state_due_s = 0.0
        if driving is None or node is None:
            return
        error = driving.exception()
        if error is None:
            self._pass(node)
        else:
            self._report("drivingError", str(error), level="FATAL", orderId=self._book.order_id, nodeId=node.node_id)

    def _pass(self, node: Node) -> None:
        self._book.passed(node)
        self._waiting += node.actions
        self._state_due_s = 0.0
        if not self._book.nodes and not self._waiting:
            self._let_go()

    def _let_go(self) -> None:
        """Restore the usual speed, and release the robot for other controllers."""
        try:
            if self._usual_m_s is not None:
                self._robot[BASE].set_config("speed_m_s", self._usual_m_s, timeout_s=_CONFIG_S).get()
            self._robot.release(BASE)
        except EALError as error:
            self._log.warning("the robot is not released", reason=error.message)
        self._usual_m_s = None

    def _stop(self) -> None:
        self._driving = self._goal = None
        try:
            self._robot[BASE].halt()
        except EALError as error:
            self._log.error("could not be halted", reason=error.message)

    # Actions.

    def _begin_action(self, action: AgvAction) -> None:
        wanted = action.parameters()
        try:
            resource, command = str(wanted["resource"]), str(wanted["command"])
            if resource not in self._robot:
                raise KeyError(resource)
        except KeyError as error:
            self._set_action(action, "FAILED", f"there is no {error}")
            self._report("actionError", f"there is no {error}", level="FATAL", actionId=action.action_id)
            return
        self._set_action(action, "RUNNING")
        self._working = action, self._robot[resource].send_cmd(command, timeout_s=_DRIVE_S)

    def _end_action(self) -> None:
        if self._working is None:
            return
        (action, answer), self._working = self._working, None
        error = answer.exception()
        self._set_action(
            action, "FINISHED" if error is None else "FAILED", str(answer.get() if error is None else error)
        )
        if error is not None:
            self._report("actionError", str(error), level="FATAL", actionId=action.action_id)
        elif not self._book.nodes and not self._waiting:
            self._let_go()

    def _act(self, message: InstantActions) -> None:
        for action in message.actions:
            known: Mapping[str, Callable[[AgvAction], str | None]] = {
                "cancelOrder": self._cancel,
                "startPause": self._pause,
                "stopPause": self._resume,
                "stateRequest": lambda _: None,
                "factsheetRequest": lambda _: self._send("factsheet", self._factsheet(), retain=True),
                "initPosition": self._init_position,
            }
            handle = known.get(action.action_type)
            try:
                problem = "unknown action" if handle is None else handle(action)
            except (EALError, KeyError, TypeError, ValueError) as error:
                problem = str(error)
            self._set_action(action, "FINISHED" if problem is None else "FAILED", problem)
            if problem is not None:
                kind = "noOrderToCancel" if action.action_type == "cancelOrder" else "instantActionError"
                self._report(kind, problem, actionId=action.action_id)

    def _cancel(self, _: AgvAction) -> str | None:
        if not self._book.nodes and self._driving is None and self._working is None and not self._waiting:
            return "there is no order to cancel"
        self._stop()
        self._book.cancel()
        for action in self._waiting if self._working is None else [*self._waiting, self._working[0]]:
            self._set_action(action, "FAILED", "cancelled")
        self._waiting, self._working, self._errors = [], None, []
        self._let_go()
        return None

    def _pause(self, _: AgvAction) -> None:
        self._is_paused = True
        if self._driving is not None:
            self._stop()

    def _resume(self, _: AgvAction) -> None:
        self._is_paused = False

    def _init_position(self, action: AgvAction) -> None:
        wanted = action.parameters()
        pose = [float(wanted[name]) for name in ("x", "y", "theta")]
        if not all(map(math.isfinite, pose)) or wanted.get("mapId") != self._settings.map_id:
            raise ValueError(f"initPosition needs finite x, y, theta and the map {self._settings.map_id}")
        self._robot["Pose"].set_value(pose)

    def _set_action(self, action: AgvAction, status: Any, result: str | None = None) -> None:
        self._actions.pop(action.action_id, None)
        self._actions[action.action_id] = _state(action, status, result)
        over = [name for name, one in self._actions.items() if one.action_status in ("FINISHED", "FAILED")]
        for name in over[: max(0, len(over) - _MOST_ACTIONS)]:
            del self._actions[name]
        self._state_due_s = 0.0

    # What it says.

    def _report(self, kind: str, description: str, *, level: Any = "WARNING", **references: str) -> None:
        found = [Reference(reference_key=key, reference_value=value) for key, value in references.items()]
        error = AgvError(error_type=kind, error_level=level, error_description=description, error_references=found)
        self._errors = [*self._errors[-9:], error]
        self._log.warning("the vehicle reports an error", kind=kind, reason=description)
        self._state_due_s = 0.0

    def _presence(self, state: Any) -> MqttMessage:
        message = Connection(**self._headers.next("connection"), connection_state=state)
        return MqttMessage(f"{self._prefix}/connection", encode(message), qos=1, retain=True)

    def _greet(self) -> MqttMessage:
        """Return the first message of a new connection. Thread: the client's."""
        self._is_greeted = False
        return self._presence("ONLINE")

    def _factsheet(self) -> Part:
        return factsheet(self._headers.next("factsheet"), self._robot)

    def _publish(self) -> None:
        if self._connection.why_not_ready() is not None:
            return
        now_s = time.perf_counter()
        try:
            if not self._is_greeted:
                self._is_greeted = True
                self._send("factsheet", self._factsheet(), retain=True)
            if now_s >= self._state_due_s:
                self._state_due_s = now_s + self._settings.state_period_s
                self._send("state", self._state())
            if self._pose is not None and now_s >= self._pose_due_s:
                self._pose_due_s = now_s + 1.0 / self._settings.visualization_rate_hz
                header = self._headers.next("visualization")
                self._send("visualization", Visualization(**header, agv_position=self._position()))
        except EALError as error:
            self._log.debug("a message is not published", reason=error.message)

    def _send(self, topic: str, message: Part, *, retain: bool = False) -> None:
        self._connection.publish(MqttMessage(f"{self._prefix}/{topic}", encode(message), retain=retain))

    def _position(self) -> AgvPosition | None:
        if self._pose is None:
            return None
        x_m, y_m, theta = self._pose
        return AgvPosition(x=x_m, y=y_m, theta=theta, map_id=self._settings.map_id, position_initialized=True)

    def _state(self) -> AgvState:
        return AgvState(
            **self._headers.next("state"),
            order_id=self._book.order_id,
            order_update_id=self._book.update_id,
            last_node_id=self._book.last_node[0],
            last_node_sequence_id=self._book.last_node[1],
            driving=self._driving is not None,
            paused=self._is_paused,
            new_base_request=self._book.needs_base(),
            operating_mode="AUTOMATIC",
            node_states=self._book.node_states(),
            edge_states=self._book.edge_states(),
            agv_position=self._position(),
            action_states=list(self._actions.values()),
            battery_state=BatteryState(battery_charge=self._charge, charging=False),
            errors=self._errors,
            safety_state=SafetyState(e_stop="NONE", field_violation=False),
        )


def _state(action: AgvAction, status: Any, result: str | None = None) -> ActionState:
    return ActionState(
        action_id=action.action_id,
        action_type=action.action_type,
        action_status=status,
        result_description=result,
    )
