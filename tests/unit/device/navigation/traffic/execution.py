"""Carries out a traffic plan with robots of any speed, in small steps; it judges by true distances."""

from __future__ import annotations

import random
from collections.abc import Mapping

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.traffic.planner import TrafficPlan


class PlanExecution:
    """Robots on their moves, each as far as a random speed takes it; some stop for a long time."""

    def __init__(self, plan: TrafficPlan, starts: Mapping[str, Point], seed: int) -> None:
        self.plan = plan
        self.done = dict.fromkeys(starts, 0)
        self.share = dict.fromkeys(starts, 0.0)
        self.from_points = dict(starts)
        self.at = dict(starts)
        self.chance = random.Random(seed)  # noqa: S311
        self.stopped_until = dict.fromkeys(starts, 0)
        self.tick = 0

    def step(self) -> bool:
        """Let each robot that may move do so for a while; return whether any robot may still move."""
        self.tick += 1
        may_move = False
        for name, moves in self.plan.moves.items():
            if self.done[name] == len(moves):
                continue
            move = moves[self.done[name]]
            if self.share[name] == 0 and any(self.done[other] < count for other, count in move.waits_for):
                continue
            may_move = True
            if self.tick < self.stopped_until[name]:
                continue
            if self.chance.random() < 0.02:
                self.stopped_until[name] = self.tick + self.chance.randrange(60)
            self.share[name] = min(1.0, self.share[name] + self.chance.uniform(0.0, 0.5) + 1e-6)
            (x0, y0), (x1, y1), share = self.from_points[name], move.to, self.share[name]
            self.at[name] = (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
            if share == 1.0:
                self.from_points[name], self.share[name] = move.to, 0.0
                self.done[name] += 1
        return may_move
