"""OrderBook: the order of one vehicle, as it is accepted, updated, passed and cancelled; no I/O.

Source: VDA 5050 2.1.0, section 6.6.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final

from .messages import AgvAction, AgvError, Edge, EdgeState, Node, NodeState, Order, Reference

_DEVIATION_M = 0.5
"""Distance from the first node within which an order is taken, if the order gives none."""
MOST_THETA: Final = math.tau
"""Headings are in rad, -pi to pi; some masters count from 0 to 2 pi."""
_MOST_PARTS = 1000
"""Every state repeats the nodes and actions that are left."""


class OrderBook:
    """The order of one vehicle.

    Args:
        map_id: the only map.
        action_types: that nodes may have.

    Attributes:
        nodes: those still to be passed, first the released ones.
        edges: those still to be left.
    """

    def __init__(self, map_id: str, action_types: Collection[str]) -> None:
        self._map_id = map_id
        self._action_types = action_types
        self.order_id = ""
        self.update_id = 0
        self.last_node = ("", 0)
        self._last_released: Node | None = None
        self.nodes: list[Node] = []
        self.edges: list[Edge] = []

    def has(self, order: Order) -> bool:
        """Return whether an order is the present one: the master repeats it."""
        return (order.order_id, order.order_update_id) == (self.order_id, self.update_id)

    def receive(self, order: Order, place: tuple[float, float] | None, *, is_over: bool) -> AgvError | None:
        """Take an order or an update that it does not have; returns why it is refused.

        A place of None is not known. If nothing is left of the present order, it `is_over`.
        """
        if (problem := self._problem(order)) is not None:
            return _refusal(order, "validationError", problem)
        if order.order_id != self.order_id:
            return self._begin(order, place, is_over=is_over)
        return self._update(order)

    def _begin(self, order: Order, place: tuple[float, float] | None, *, is_over: bool) -> AgvError | None:
        if not is_over:
            return _refusal(order, "orderError", f"order {self.order_id} is not over")
        first = order.nodes[0]
        position = first.node_position
        if place is None or position is None:
            return _refusal(order, "orderError", "the vehicle does not know where it is")
        allowed_m = _DEVIATION_M if position.allowed_deviation_xy is None else position.allowed_deviation_xy
        away_m = math.dist(place, (position.x, position.y))
        if first.node_id != self.last_node[0] and away_m > allowed_m + 1e-9:
            return _refusal(
                order, "noRouteError", f"the first node is {away_m:.2f} m away; {allowed_m:g} m are allowed"
            )
        self.order_id, self.update_id = order.order_id, order.order_update_id
        self.nodes, self.edges = list(order.nodes), list(order.edges)
        self._note_released()
        return None

    def _update(self, order: Order) -> AgvError | None:
        if order.order_update_id < self.update_id:
            return _refusal(order, "orderUpdateError", f"update {self.update_id} is newer")
        first, last = order.nodes[0], self._last_released
        if last is None or (first.node_id, first.sequence_id) != (last.node_id, last.sequence_id):
            wanted = "none" if last is None else f"{last.node_id} ({last.sequence_id})"
            return _refusal(order, "orderUpdateError", f"an update must begin at the last released node, {wanted}")
        self.update_id = order.order_update_id
        is_passed = self.last_node == (first.node_id, first.sequence_id)
        kept = [node for node in self.nodes if node.released]
        self.nodes = kept + order.nodes[1:] if not is_passed else list(order.nodes[1:])
        self.edges = [edge for edge in self.edges if edge.released] + list(order.edges)
        self._note_released()
        return None

    def _note_released(self) -> None:
        released = [node for node in self.nodes if node.released]
        self._last_released = released[-1] if released else self._last_released

    def _problem(self, order: Order) -> str | None:
        """Return what is wrong with an order by itself."""
        nodes, edges = order.nodes, order.edges
        if len(nodes) + sum(len(node.actions) for node in nodes) > _MOST_PARTS:
            return f"an order has at most {_MOST_PARTS} nodes and actions together"
        if not nodes or len(edges) != len(nodes) - 1:
            return f"{len(nodes)} nodes and {len(edges)} edges: there must be one edge between two nodes"
        first = nodes[0].sequence_id
        problems = [self._node_problem(node, first + 2 * number) for number, node in enumerate(nodes)]
        problems += [
            _edge_problem(edge, first + 2 * number + 1, nodes[number].node_id, nodes[number + 1].node_id)
            for number, edge in enumerate(edges)
        ]
        if (problem := next(filter(None, problems), None)) is not None:
            return problem
        released = [one.released for pair in zip(nodes, [*edges, None], strict=True) for one in pair if one is not None]
        if not released[0] or released != sorted(released, reverse=True):
            return "released nodes and edges must come first"
        return None

    def _node_problem(self, node: Node, sequence_id: int) -> str | None:
        if node.sequence_id != sequence_id:
            return f"node {node.node_id} has sequenceId {node.sequence_id}, not {sequence_id}"
        if node.node_position is None:
            return f"node {node.node_id} has no nodePosition"
        if node.node_position.map_id != self._map_id:
            return f"node {node.node_id} is on map {node.node_position.map_id}; this is {self._map_id}"
        if abs(node.node_position.theta or 0.0) > MOST_THETA:
            return f"node {node.node_id} has a theta of {node.node_position.theta:g}; it is in rad"
        unknown = {action.action_type for action in node.actions} - set(self._action_types)
        return f"node {node.node_id} has unknown actions: {', '.join(sorted(unknown))}" if unknown else None

    def next_node(self) -> Node | None:
        """Return the next node to drive to; None if none is released."""
        return self.nodes[0] if self.nodes and self.nodes[0].released else None

    def edge_to(self, node: Node) -> Edge | None:
        """Return the edge that leads to a node."""
        return next((edge for edge in self.edges if edge.sequence_id == node.sequence_id - 1), None)

    def passed(self, node: Node) -> None:
        """Note that the vehicle has passed a node."""
        self.last_node = node.node_id, node.sequence_id
        self.nodes = [one for one in self.nodes if one.sequence_id > node.sequence_id]
        self.edges = [one for one in self.edges if one.sequence_id > node.sequence_id]

    def place_at(self, node_id: str) -> None:
        """Note that the vehicle was put somewhere else; the last node is that of its new place."""
        self.last_node, self._last_released = (node_id, 0), None

    def cancel(self) -> list[AgvAction]:
        """Forget the nodes and edges of the order; returns the actions that were left."""
        left = [action for node in self.nodes for action in node.actions]
        self.nodes, self.edges, self._last_released = [], [], None
        return left

    def needs_base(self) -> bool:
        """Return whether the vehicle waits for the release of further nodes."""
        return bool(self.nodes) and not self.nodes[0].released

    def node_states(self) -> list[NodeState]:
        """Return the nodes for a state."""
        return [
            NodeState(
                node_id=one.node_id,
                sequence_id=one.sequence_id,
                released=one.released,
                node_position=one.node_position,
            )
            for one in self.nodes
        ]

    def edge_states(self) -> list[EdgeState]:
        """Return the edges for a state."""
        return [
            EdgeState(edge_id=one.edge_id, sequence_id=one.sequence_id, released=one.released) for one in self.edges
        ]


def _refusal(order: Order, error_type: str, description: str) -> AgvError:
    references = [
        Reference(reference_key="orderId", reference_value=order.order_id),
        Reference(reference_key="orderUpdateId", reference_value=str(order.order_update_id)),
    ]
    return AgvError(
        error_type=error_type, error_level="WARNING", error_description=description, error_references=references
    )


def _edge_problem(edge: Edge, sequence_id: int, start: str, end: str) -> str | None:
    if edge.sequence_id != sequence_id or (edge.start_node_id, edge.end_node_id) != (start, end):
        return f"edge {edge.edge_id} does not join {start} and {end}"
    if edge.max_speed is not None and edge.max_speed <= 0:
        return f"edge {edge.edge_id} has a maxSpeed of {edge.max_speed:g} m/s"
    return f"edge {edge.edge_id} has actions; only nodes may have some" if edge.actions else None
