"""FleetVehicle: one robot of the fleet as an AGV of another master.

When the broker is lost, the vehicle drives on to the last released node, as the standard demands.

Thread: one at a time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Final

from eal_actors import EALData, EALError, Future, RobotHandle
from eal_actors.plugin import Clock, DataError, get_logger, is_plausible

from .factsheet import ACTIONS, factsheet
from .messages import AgvAction, AgvPosition, AgvState, BatteryState, InstantActions, Order, SafetyState, Visualization
from .order_book import MOST_THETA, OrderBook
from .order_driver import OrderDriver
from .settings import BridgeSettings
from .vehicle_report import VehicleReport
from .vehicle_topics import VehicleTopics

_UNKNOWN_CHARGE: Final = 80.0
"""The standard's value for a battery that is good, of a robot that does not measure it."""
_MOST_ACTIONS: Final = 100
"""In a message: the other vehicles wait for it."""


class FleetVehicle:
    """One robot as an AGV."""

    def __init__(self, robot: RobotHandle, settings: BridgeSettings, clock: Clock) -> None:
        self._robot = robot
        self._settings = settings
        self._clock = clock
        self._log = get_logger(robot=robot.name)
        self._topics = VehicleTopics(robot.name, settings, clock)
        self._report = VehicleReport(robot.name)
        self._book = OrderBook(settings.map_id, ACTIONS)
        self._driver = OrderDriver(robot, self._book, self._report)
        self._pose: tuple[float, float, float] | None = None
        self._placed_s = -math.inf
        self._charge = _UNKNOWN_CHARGE
        self._is_paused = False
        self._placing: tuple[AgvAction, tuple[float, float, float], Future[int]] | None = None
        self._stopping: list[tuple[AgvAction, Future[int]]] = []
        self._state_due_s = 0.0
        self._pose_due_s = 0.0

    def take_value(self, name: str, data: EALData) -> None:
        """Keep a sampled value. Thread: the sampler's."""
        if name == "Pose":
            if data.stamp_s is None or data.stamp_s >= self._placed_s:  # not of the place before initPosition
                x_m, y_m, yaw_rad = map(float, data.value)
                self._pose = x_m, y_m, yaw_rad
        else:
            self._charge = 100.0 * float(data.value)

    def step(self) -> None:
        """Take messages, go on with the order, and publish what has changed."""
        try:
            for message in (*self._topics.instant_actions(), *self._topics.orders()):
                self._take(message)
            self._hear_of_place()
            self._hear_of_halts()
            is_held = self._is_paused or self._report.is_fatal
            self._driver.go_on(is_held=is_held, is_placed=self._pose is not None)
        except EALError as error:
            self._log.warning("the vehicle cannot go on", reason=error.message)
        self._publish()

    def fail(self) -> None:
        """Halt the robot after a failure of this program; the order stays until it is cancelled."""
        self._driver.stop()
        self._report.add("internalError", "the bridge failed; see its log", level="FATAL")

    def close(self) -> None:
        """Halt the robot if it drives, and say farewell."""
        if self._driver.is_busy:
            self._driver.stop()
        self._topics.close()

    def await_broker(self) -> None:
        """Wait for the broker's first answer, for a short time. Thread: blocks the caller."""
        self._topics.await_broker()

    def why_not_ready(self) -> str | None:
        """Return why the broker is out of reach; None if it is not."""
        return self._topics.why_not_ready()

    def _take(self, message: Order | InstantActions | DataError) -> None:
        if isinstance(message, DataError):
            self._report.add("validationError", message.message)
        elif isinstance(message, Order):
            self._accept(message)
        elif len(message.actions) > _MOST_ACTIONS:
            self._report.add("validationError", f"instantActions has at most {_MOST_ACTIONS} actions")
        else:
            for action in message.actions:
                self._act(action)

    def _accept(self, order: Order) -> None:
        if self._book.has(order):
            return
        place, is_update = None if self._pose is None else self._pose[:2], order.order_id == self._book.order_id
        refusal = self._book.receive(order, place, is_over=not self._driver.has_order)
        if refusal is not None:
            self._report.keep(refusal)
        else:
            self._report.clear(keep_fatal=is_update)
            self._report.await_actions([action for node in order.nodes for action in node.actions])

    # Instant actions.

    def _act(self, action: AgvAction) -> None:
        known: Mapping[str, Callable[[AgvAction], str | None]] = {
            "cancelOrder": self._cancel,
            "startPause": self._pause,
            "stopPause": self._resume,
            "stateRequest": lambda _: None,
            "factsheetRequest": self._send_factsheet,
            "initPosition": self._init_position,
        }
        handle = known.get(action.action_type)
        try:
            problem = "unknown action" if handle is None else handle(action)
        except (EALError, KeyError, TypeError, ValueError, OverflowError) as error:
            problem = str(error)
        if any(one is action for one in (self._placing or ())[:1] + tuple(begun for begun, _ in self._stopping)):
            self._report.set_action(action, "RUNNING")
        else:
            self._end_action(action, problem, "noOrderToCancel" if handle == self._cancel else "instantActionError")

    def _end_action(self, action: AgvAction, problem: str | None, kind: str = "instantActionError") -> None:
        self._report.set_action(action, "FINISHED" if problem is None else "FAILED", problem)
        if problem is not None:
            self._report.add(kind, problem, actionId=action.action_id)

    def _cancel(self, action: AgvAction) -> str | None:
        if not self._driver.has_order and not self._driver.is_halting and not self._report.is_fatal:
            return "there is no order to cancel"
        self._stopping.append((action, self._driver.cancel()))
        self._report.clear()
        return None

    def _pause(self, action: AgvAction) -> None:
        self._is_paused = True
        if self._driver.is_driving:
            self._stopping.append((action, self._driver.stop()))

    def _hear_of_halts(self) -> None:
        """End the actions whose halt the robot has confirmed, or could not be told."""
        waiting, self._stopping = self._stopping, []
        for action, halting in waiting:
            if not halting.done():
                self._stopping.append((action, halting))
            else:
                error = halting.exception()
                self._end_action(action, None if error is None else f"the halt is repeated until it succeeds: {error}")

    def _resume(self, _: AgvAction) -> None:
        self._is_paused = False

    def _send_factsheet(self, _: AgvAction | None = None) -> None:
        self._topics.send("factsheet", factsheet(self._topics.header("factsheet"), self._robot), retain=True)

    def _init_position(self, action: AgvAction) -> None:
        wanted = action.parameters()
        pose = float(wanted["x"]), float(wanted["y"]), float(wanted["theta"])
        if not is_plausible(*pose) or abs(pose[2]) > MOST_THETA or wanted.get("mapId") != self._settings.map_id:
            raise ValueError(
                f"initPosition needs finite x, y within 1,000 km, theta in rad, and the map {self._settings.map_id}"
            )
        if self._driver.has_order:
            raise ValueError(f"order {self._book.order_id} is not over")
        if self._placing is not None:
            raise ValueError("another initPosition is not over")
        self._placing = action, pose, self._robot["Pose"].set_value(list(pose))

    def _hear_of_place(self) -> None:
        if self._placing is not None and self._placing[2].done():
            (action, pose, answer), self._placing = self._placing, None
            error = answer.exception()
            if error is None:
                self._pose, self._placed_s = pose, self._clock.now()  # not sampled yet; the next order begins there
                self._book.place_at(str(action.parameters().get("lastNodeId", "")))
            self._end_action(action, None if error is None else str(error))

    # What it publishes.

    def _publish(self) -> None:
        if self._topics.why_not_ready() is not None:
            return
        now_s = time.perf_counter()
        try:
            if self._topics.take_greeting():
                self._send_factsheet()
            if self._report.is_due or now_s >= self._state_due_s:
                self._report.is_due, self._state_due_s = False, now_s + self._settings.state_period_s
                self._topics.send("state", self._state())
            if self._pose is not None and now_s >= self._pose_due_s:
                self._pose_due_s = now_s + 1.0 / self._settings.visualization_rate_hz
                header = self._topics.header("visualization")
                self._topics.send("visualization", Visualization(**header, agv_position=self._position()))
        except EALError as error:
            self._log.debug("a message is not published", reason=error.message)

    def _position(self) -> AgvPosition | None:
        if self._pose is None:
            return None
        x_m, y_m, theta = self._pose
        return AgvPosition(x=x_m, y=y_m, theta=theta, map_id=self._settings.map_id, position_initialized=True)

    def _state(self) -> AgvState:
        return AgvState(
            **self._topics.header("state"),
            order_id=self._book.order_id,
            order_update_id=self._book.update_id,
            last_node_id=self._book.last_node[0],
            last_node_sequence_id=self._book.last_node[1],
            driving=self._driver.is_driving,
            paused=self._is_paused,
            new_base_request=self._book.needs_base(),
            operating_mode="AUTOMATIC",
            node_states=self._book.node_states(),
            edge_states=self._book.edge_states(),
            agv_position=self._position(),
            action_states=self._report.actions,
            battery_state=BatteryState(battery_charge=self._charge, charging=False),
            errors=self._report.errors,
            safety_state=SafetyState(
                e_stop="NONE" if self._robot.stopped_because is None else "REMOTE", field_violation=False
            ),
        )
