"""The base of an AGV: its motions are orders, and a stop is `cancelOrder`."""

from __future__ import annotations

import math
import uuid
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DifferentialBase,
    EALData,
    PluginContext,
    ResourceInfo,
    UnavailableError,
    UnsupportedError,
)

from .link import AgvLink
from .orders import OrderLimits, Place, path, standing, turn
from .settings import Settings

_PERIOD_S: Final = 0.05
_MOST_NODES: Final = 500
_WHEEL_CONFIGS: Final = frozenset({"twist_timeout_s", "wheelbase_m", "track_factor", "wheel_ratio"})


class Base(DifferentialBase):
    """Drives the AGV by orders; get_status: 0 stands, 1 has an order or moves, 2 is held."""

    value = None  # type: ignore[assignment]  # no velocities

    def __init__(self, context: PluginContext, link: AgvLink) -> None:
        settings: Settings = context.settings
        super().__init__(settings.drivetrain("AGV", track_m=settings.radius_m), context)
        self._clock = context.clock
        self._settings = settings
        self._link = link

    @override
    def not_ready(self) -> str | None:
        return self._link.why_no_orders()

    def get_status(self) -> int:
        """Return 0 while it stands without an order, 1 with one, 2 while its protective field is violated."""
        state = self._link.state()
        return 2 if state.safety_state.field_violation else 1 if state.is_active else 0

    @override
    def halt(self) -> None:
        self._link.halt()

    @override
    def background(self) -> Activity:
        while True:
            self._link.look_after()
            yield _PERIOD_S

    @override
    def set_value(self, data: EALData) -> Activity:
        raise UnsupportedError("set_value: VDA 5050 knows no velocities: use goto, follow or f<metres>")

    @override
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        raise UnsupportedError("VDA 5050 knows no velocities")

    @override
    def go_to(self, goal: Any) -> Activity:
        return self._go_along([self.goal_numbers(goal)])

    @override
    def follow_path(self, path: Any) -> Activity:
        return self._go_along([(x_m, y_m, None) for x_m, y_m in self.path_points(path)])

    def _go_along(self, goals: Sequence[Place]) -> Activity:
        here = self._link.position()
        path = [(here.x, here.y), *((x_m, y_m) for x_m, y_m, _ in goals)]
        return self.along(path, goals[-1][2], self._order(goals))

    @override
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        here = self._link.position()
        x_m = here.x + distance_m * math.cos(here.theta)
        y_m = here.y + distance_m * math.sin(here.theta)
        return self._order([(x_m, y_m, here.theta)], is_reverse=distance_m < 0)

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        return self._order(turn(self._link.position(), angle_rad))

    def _order(self, goals: Sequence[Place], *, is_reverse: bool = False) -> Activity:
        if len(goals) > _MOST_NODES:
            raise ArgumentError(f"an order has at most {_MOST_NODES} nodes, not {len(goals)}")
        limits = OrderLimits(
            self.speed_m_s, math.radians(self.turn_rate_deg_s), self._settings.goal_deviation_m, is_reverse
        )
        return self._drive_order(goals, limits)

    def _drive_order(self, goals: Sequence[Place], limits: OrderLimits) -> Activity:
        """Send one order and wait for its end; closing the activity cancels it."""
        is_over = False
        try:
            yield from self._settle()
            yield from self._link.take_command()
            here = self._link.position()
            order_id = f"eal-{uuid.uuid4().hex[:12]}"
            nodes, edges = path(order_id, here, goals, self._settings.map_id or here.map_id, limits)
            sent_s = self._link.send_order(order_id, nodes, edges)
            is_accepted = False
            while not is_over:
                state = self._link.state_since(sent_s)
                if state is not None:
                    now = standing(order_id, nodes, state)
                    is_accepted, is_over = now.is_accepted or is_accepted, now.is_done
                    self.progress(now.passed / (len(nodes) - 1), now.text)
                if not is_accepted and self._clock.now() - sent_s > self._settings.accept_timeout_s:
                    raise UnavailableError(
                        f"the AGV did not take the order within {self._settings.accept_timeout_s:g} s"
                    )
                if not is_over:
                    yield _PERIOD_S
        finally:
            if is_over:
                self._link.release()
            else:
                self.halt()
        return 1

    def _settle(self) -> Activity:
        """Wait until a former order is cancelled: an AGV refuses a new one before."""
        end_s = self._clock.now() + self._settings.accept_timeout_s
        while self._link.is_halting:
            if self._clock.now() > end_s:
                raise UnavailableError("the AGV does not confirm that its former order is cancelled")
            self._link.look_after()
            yield _PERIOD_S

    @override
    def _make_info(self) -> ResourceInfo:
        """Leave out what velocities and wheels need."""
        info = super()._make_info()
        configs = tuple(known for known in info.configs if known.name not in _WHEEL_CONFIGS)
        return replace(info, methods=info.methods - {"set_value"}, configs=configs)
