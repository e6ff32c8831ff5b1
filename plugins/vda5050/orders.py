"""Orders for an AGV, and what its state says of them; pure functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from eal_actors.plugin import ResourceFaultError, UnavailableError, wrapped_rad

from .messages import AgvAction, AgvPosition, AgvState, Edge, Node, NodePosition

_REJECTIONS: Final = ("validationError", "orderError", "orderUpdateError", "noRouteError", "mapError")
_GOAL_DEVIATION_RAD: Final = 0.1
_REVERSE_RAD: Final = 3.14159265359
"""Driving backwards, as greatest value of the published schema."""


@dataclass(frozen=True, slots=True)
class OrderLimits:
    """How an order is to be driven.

    Attributes:
        deviation_m: distance from a node at which it counts as reached.
    """

    speed_m_s: float
    turn_rate_rad_s: float
    deviation_m: float
    is_reverse: bool = False


Place = tuple[float, float, float | None]
"""x in m, y in m, and yaw in rad or None for any."""


def path(
    order_id: str, start: AgvPosition, goals: Sequence[Place], map_id: str, limits: OrderLimits
) -> tuple[list[Node], list[Edge]]:
    """Return the nodes and edges of an order from where the AGV is along some places."""
    places = [(start.x, start.y, start.theta), *goals]
    nodes = [_node(order_id, number, place, map_id, limits) for number, place in enumerate(places)]
    edges = [
        Edge(
            edge_id=f"{order_id}-e{number}",
            sequence_id=2 * number + 1,
            released=True,
            start_node_id=nodes[number].node_id,
            end_node_id=nodes[number + 1].node_id,
            max_speed=limits.speed_m_s,
            max_rotation_speed=limits.turn_rate_rad_s,
            orientation=_REVERSE_RAD if limits.is_reverse else None,
            orientation_type="TANGENTIAL" if limits.is_reverse else None,
            actions=[],
        )
        for number in range(len(goals))
    ]
    return nodes, edges


def _node(order_id: str, number: int, place: Place, map_id: str, limits: OrderLimits) -> Node:
    x_m, y_m, yaw_rad = place
    is_start = number == 0
    position = NodePosition(
        x=x_m,
        y=y_m,
        theta=None if yaw_rad is None else max(-_REVERSE_RAD, min(_REVERSE_RAD, wrapped_rad(yaw_rad))),
        allowedDeviationXY=max(limits.deviation_m, 0.5) if is_start else limits.deviation_m,
        allowed_deviation_theta=3.141592654 if is_start or yaw_rad is None else _GOAL_DEVIATION_RAD,
        map_id=map_id,
    )
    return Node(
        node_id=f"{order_id}-n{number}", sequence_id=2 * number, released=True, node_position=position, actions=[]
    )


def turn(start: AgvPosition, angle_rad: float) -> list[Place]:
    """Return the places of a turn: one for at most each quarter, so that the AGV turns the given way."""
    count = max(1, math.ceil(abs(angle_rad) / (math.pi / 2) - 1e-6))
    return [(start.x, start.y, wrapped_rad(start.theta + angle_rad * (n + 1) / count)) for n in range(count)]


def instant(action_type: str, action_id: str) -> AgvAction:
    """Return an instant action without parameters."""
    return AgvAction(action_type=action_type, action_id=action_id, blocking_type="HARD")


@dataclass(frozen=True, slots=True)
class Standing:
    """How far an order is."""

    is_accepted: bool
    is_done: bool = False
    passed: int = 0
    text: str = ""


def standing(order_id: str, nodes: Sequence[Node], state: AgvState) -> Standing:
    """Return how far an order is, by a state that arrived after it was sent.

    Raises:
        UnavailableError: the AGV refuses it.
        ResourceFaultError: the AGV reports a fatal error, was taken over, stopped, or dropped the order.
    """
    for error in state.errors:
        if error.is_about(order_id) and error.error_type in _REJECTIONS:
            raise UnavailableError(f"the AGV refuses the order: {error.text()}")
        if error.error_level == "FATAL":
            raise ResourceFaultError(f"halted: the AGV reports {error.text()}")
    if (problem := why_not_automatic(state)) is not None:
        raise ResourceFaultError(f"halted: {problem}")
    if state.order_id != order_id:
        return Standing(is_accepted=False)
    left = len(state.node_states)
    goal = nodes[-1]
    is_there = (state.last_node_id, state.last_node_sequence_id) == (goal.node_id, goal.sequence_id)
    if not left and not state.edge_states and not is_there and not state.driving:
        raise ResourceFaultError("halted: the AGV has dropped the order: it was cancelled by hand or by another master")
    text = "paused" if state.paused else "something is in its way" if state.safety_state.field_violation else ""
    is_done = is_there and not state.is_active
    return Standing(True, is_done, max(0, len(nodes) - 1 - left), text or f"{left} nodes left")


def why_not_automatic(state: AgvState) -> str | None:
    """Return why the AGV takes no orders now; None if it does."""
    if state.safety_state.e_stop != "NONE":
        return f"the AGV's emergency stop is active ({state.safety_state.e_stop})"
    if state.operating_mode not in ("AUTOMATIC", "SEMIAUTOMATIC"):
        return f"the AGV is in mode {state.operating_mode}, which takes no orders"
    return None
