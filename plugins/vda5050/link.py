"""AgvLink: one AGV's topics at the broker, its newest state, and the orders to it.

While the AGV has an order of ours, a second connection is open whose last will is `cancelOrder`: when this process is
killed or the network is lost, the broker cancels the order. A halt is repeated until the AGV's state confirms it.

Thread: any.
"""

from __future__ import annotations

import math
import threading
import uuid
from typing import Final, TypeVar

from eal_actors.plugin import (
    Activity,
    DataError,
    EALError,
    LogLimit,
    OdometryNoise,
    PluginContext,
    UnavailableError,
    get_logger,
)

from ..mqtt.connection import MqttConnection, MqttMessage, TopicInbox, age_text
from ..mqtt.plugin import client_name
from .messages import (
    AgvAction,
    AgvHeader,
    AgvPosition,
    AgvState,
    Connection,
    Edge,
    Headers,
    InstantActions,
    Node,
    Order,
    Visualization,
    decode,
    encode,
)
from .orders import instant, why_not_automatic
from .settings import Settings

_M = TypeVar("_M", bound=AgvHeader)

_MOST_BYTES: Final = 1 << 20
_POLL_S: Final = 0.02
_REPEAT_S: Final = 1.0
"""Time after which an unconfirmed halt is sent again."""
_LONG_S: Final = 3.0
_FIRST_S: Final = 2.0
"""A broker sends what it has retained at once; an AGV sends its state when something changes."""
_OPEN_S: Final = 5.0
_NOISE: Final = OdometryNoise(scatter_m=0.0, turn_scatter_rad=0.0, scale_share=1e-4, drift_rad_m=1e-4, turn_share=1e-4)
"""The AGV localises itself, so errors do not grow with the way."""


class AgvLink:
    """The link to one AGV."""

    def __init__(self, context: PluginContext, settings: Settings) -> None:
        self._settings = settings
        self._clock = context.clock
        self._localizer = context.localizer
        self._robot = context.robot
        self._prefix = f"{settings.interface}/v2/{settings.manufacturer}/{settings.serial_number}"
        self._headers = Headers(settings.manufacturer, settings.serial_number)
        self._lock = threading.RLock()
        self._log = get_logger(robot=context.robot)
        self._connection = MqttConnection(settings, context.clock, client_name(context.robot))
        subscribe = self._connection.subscribe
        self._states = subscribe(f"{self._prefix}/state", depth=4, max_bytes=_MOST_BYTES)
        self._poses = subscribe(f"{self._prefix}/visualization", depth=4, max_bytes=_MOST_BYTES)
        self._presence = subscribe(f"{self._prefix}/connection", qos=1, max_bytes=_MOST_BYTES)
        self.factsheets: Final = subscribe(f"{self._prefix}/factsheet", max_bytes=_MOST_BYTES)
        self._newest: tuple[AgvState, float] | None = None
        self._position: AgvPosition | None = None
        self._connected: str | None = None
        self._problem: str | None = None
        self._ignored = LogLimit()
        self._commander: MqttConnection | None = None
        self._released: MqttConnection | None = None  # it may still be closing
        self._halted_s: float | None = None
        self._repeat_s = math.inf
        self._cancellation = ""
        self._localizer.attach(_NOISE, refresh=self.refresh, not_ready=self.why_not_ready)
        self._connection.open()

    def await_first_state(self) -> None:
        """Wait until the AGV's state is known, so that the first call answers; not for an AGV that is offline."""
        self._connection.wait_until(lambda: self.why_not_ready() is None or self._is_away(), _FIRST_S)

    def _is_away(self) -> bool:
        return self._connected not in (None, "ONLINE")

    def close(self) -> None:
        """End the connections."""
        self.release()
        for connection in (self._released, self._connection):
            if connection is not None:
                connection.close()

    # What the AGV says.

    def refresh(self) -> None:
        """Take the messages that have arrived."""
        with self._lock:
            while (connection := self._take(Connection, self._presence)) is not None:
                self._connected = connection[0].connection_state
            while (state := self._take(AgvState, self._states)) is not None:
                self._newest, self._problem = state, None
                self._follow(state[0].agv_position, state[1])
            while (pose := self._take(Visualization, self._poses)) is not None:
                self._follow(pose[0].agv_position, pose[1])

    def _take(self, kind: type[_M], inbox: TopicInbox) -> tuple[_M, float] | None:
        while True:
            try:
                received = inbox.take()
                return None if received is None else (decode(kind, received.payload), received.arrived_s)
            except DataError as error:
                if self._problem is None and (more := self._ignored.admit()) is not None:
                    self._log.warning("a message is ignored", topic=inbox.topic, reason=error.message, **more)
                self._problem = f"{inbox.topic}: {error.message}"

    def _follow(self, position: AgvPosition | None, arrived_s: float) -> None:
        if position is None or not position.position_initialized:
            return
        if self._position is None:
            self._localizer.begin_at(position.x, position.y, position.theta)
        self._position = position
        self._localizer.odometry(position.x, position.y, position.theta, arrived_s)

    def why_not_ready(self) -> str | None:
        """Return why the AGV cannot be reached, or its state is not known."""
        self.refresh()
        if (problem := self._connection.why_not_ready()) is not None:
            return problem
        if self._connected != "ONLINE":
            said = "nothing yet" if self._connected is None else self._connected
            return self._problem or f"the AGV is not online: {self._prefix}/connection says {said}"
        if self._clock.now() - self.arrived_s <= self._settings.state_timeout_s and self._problem is None:
            return None
        return self._problem or f"no state on {self._prefix}/state{age_text(self.arrived_s, self._clock.now())}"

    def why_no_orders(self) -> str | None:
        """Return why the AGV takes no orders now."""
        if (problem := self.why_not_ready()) is not None or self._newest is None:
            return problem
        if (problem := why_not_automatic(self._newest[0])) is not None:
            return problem
        return None if self._position is not None else "the AGV does not know its position: send initPosition"

    def state(self) -> AgvState:
        """Return the newest state.

        Raises:
            UnavailableError: the AGV is out of reach.
        """
        problem = self.why_not_ready()
        if problem is not None or self._newest is None:
            raise UnavailableError(problem or "no state has arrived")
        return self._newest[0]

    def state_since(self, sent_s: float) -> AgvState | None:
        """Return the newest state if it arrived after a time. Raises what `state` raises."""
        state = self.state()
        return state if self.arrived_s > sent_s else None

    @property
    def is_halting(self) -> bool:
        """Whether a halt is not confirmed yet."""
        return self._halted_s is not None

    @property
    def arrived_s(self) -> float:
        """When the newest state arrived, by the fleet's clock."""
        return -math.inf if self._newest is None else self._newest[1]

    def position(self) -> AgvPosition:
        """Return where the AGV is.

        Raises:
            UnavailableError: it is out of reach, or does not know.
        """
        self.state()
        if self._position is None:
            raise UnavailableError("the AGV does not know its position: send initPosition")
        return self._position

    # What is said to the AGV.

    def take_command(self) -> Activity:
        """Open the connection whose last will cancels the order.

        Raises:
            UnavailableError: the broker does not answer.
        """
        if self._commander is None:
            will = self._actions_message([instant("cancelOrder", f"will-{uuid.uuid4().hex[:12]}")])
            self._commander = MqttConnection(self._settings, self._clock, client_name(self._robot), will=will)
            self._commander.open()
        end_s = self._clock.now() + _OPEN_S
        while (problem := self._commander.why_not_ready()) is not None:
            if self._clock.now() > end_s:
                raise UnavailableError(problem)
            yield _POLL_S

    def send_order(self, order_id: str, nodes: list[Node], edges: list[Edge]) -> float:
        """Send an order; returns the fleet's time.

        Raises:
            UnavailableError: the broker is out of reach.
        """
        if self._commander is None:
            raise UnavailableError("nobody commands the AGV")
        order = Order(**self._headers.next("order"), order_id=order_id, order_update_id=0, nodes=nodes, edges=edges)
        self._commander.publish(MqttMessage(f"{self._prefix}/order", encode(order)))
        return self._clock.now()

    def send_actions(self, actions: list[AgvAction]) -> None:
        """Send instant actions.

        Raises:
            UnavailableError: the broker is out of reach.
        """
        message = self._actions_message(actions)
        commander = self._commander
        (commander if commander is not None and commander.why_not_ready() is None else self._connection).publish(
            message
        )

    def _actions_message(self, actions: list[AgvAction]) -> MqttMessage:
        message = InstantActions(**self._headers.next("instantActions"), actions=actions)
        return MqttMessage(f"{self._prefix}/instantActions", encode(message))

    # Stopping.

    def halt(self) -> None:
        """Cancel what the AGV does, unless its state shows that it does nothing."""
        self.refresh()
        if self._commander is None and self._newest is not None and not self._newest[0].is_active:
            return
        self._halted_s = self._clock.now()
        self._send_halt()

    def _send_halt(self) -> None:
        self._repeat_s = self._clock.now() + _REPEAT_S
        tag = uuid.uuid4().hex[:12]
        self._cancellation = f"cancel-{tag}"
        try:
            self.send_actions([instant("startPause", f"pause-{tag}"), instant("cancelOrder", self._cancellation)])
        except EALError as error:
            self._log.warning("the AGV is not reached by a halt, which is repeated", reason=error.message)

    def look_after(self) -> None:
        """Repeat a halt until it is confirmed; let the AGV go when nothing is ordered."""
        self.refresh()
        if self._halted_s is None:
            return
        state = self._newest[0] if self._newest is not None and self._newest[1] > self._halted_s else None
        is_heard = state is not None and state.action(self._cancellation) is not None
        is_long_ago = self._clock.now() - self._halted_s > _LONG_S  # an AGV may forget actions that are over
        if state is not None and not state.is_active and (is_heard or is_long_ago):
            self._halted_s = None
            if state.paused:
                try:
                    self.send_actions([instant("stopPause", f"resume-{uuid.uuid4().hex[:12]}")])
                except EALError as error:
                    self._log.warning("the AGV stays paused", reason=error.message)
            self.release()
        elif self._clock.now() >= self._repeat_s:
            self._send_halt()

    def release(self) -> None:
        """Let the AGV go: nothing is ordered any more."""
        commander, self._commander = self._commander, None
        if commander is not None:
            commander.close(wait=False)
            self._released = commander
