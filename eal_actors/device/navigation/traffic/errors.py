"""The error of planning traffic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from typing_extensions import override

from eal_actors.kernel.errors import ArgumentError


class TrafficError(ArgumentError):
    """Some robots cannot all reach their goals. `robots` is empty if it is about all of them."""

    def __init__(self, message: str = "", *, robots: Sequence[str] = (), **place: str | None) -> None:
        super().__init__(message, **place)
        self.robots = tuple(robots)

    @override
    def copy(self) -> Self:
        return type(self)(self.message, robots=self.robots, robot=self.robot, resource=self.resource)
