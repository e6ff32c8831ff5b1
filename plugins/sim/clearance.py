"""How near robots come to each other and to all else: worked out at every tick at which it may matter."""

from __future__ import annotations

from collections.abc import Iterable

from eal_actors.device.proximity import ProximityObserver
from eal_actors.device.world import WorldModel

from .arena import from_drops_m
from .nearness import FASTEST_M_S
from .robot import SimRobot
from .view import View


class Clearance:
    """Tells an observer of the gaps round robots.

    After a look, a robot is left alone until something may have come nearer to it than the observer cares about: even
    the fastest covers only so much in a tick.

    Args:
        model: the world.
        view: where everything is.
        observer: is told.
        tick_s: length of a physics tick.

    Attributes:
        is_stale: somebody was put somewhere since the last look.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, model: WorldModel, view: View, observer: ProximityObserver, tick_s: float) -> None:
        self.is_stale = False
        self._model = model
        self._view = view
        self._observer = observer
        self._tick_s = tick_s
        self._closing_m = 2 * FASTEST_M_S * tick_s
        self._due: dict[SimRobot, int] = {}

    def look(self, robots: Iterable[SimRobot], tick: int) -> None:
        """Tell what is near the robots at the end of a tick."""
        if self.is_stale:
            self.is_stale = False
            self._due.clear()
        for robot in robots:
            if self._due.get(robot, 0) > tick:
                continue
            gaps_m = self._gaps_m(robot)
            cares_m = self._observer.observe(tick * self._tick_s, robot.name, robot.pose[:2], gaps_m)
            spare_m = min(gaps_m.values(), default=self._observer.reach_m) - cares_m
            self._due[robot] = tick + 1 + int(max(0.0, spare_m) / self._closing_m)

    def _gaps_m(self, robot: SimRobot) -> dict[str, float]:
        radius_m, reach_m = robot.make.radius_m, self._observer.reach_m
        hits = self._view.space.point_query(robot.pose[:2], radius_m + reach_m, robot.filter)
        gaps_m = {self._view.names[hit.shape]: hit.distance - radius_m for hit in hits}
        for number, from_drop_m in enumerate(from_drops_m(self._model, robot.pose)):
            if from_drop_m < radius_m + reach_m:
                gaps_m[f"drops[{number}]"] = from_drop_m - radius_m
        return gaps_m
