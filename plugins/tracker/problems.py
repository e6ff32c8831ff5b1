"""The problems that a tracker reports: markers and cameras that differ from the settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, TypeAlias

_TOLD_EACH_S: Final = 60.0

ProblemKind: TypeAlias = Literal[
    "camera_not_ready",
    "wrong_picture_size",
    "camera_pose_unknown",
    "camera_moved",
    "floor_marker_moved",
    "unknown_marker",
    "seen_twice",
    "mirrored",
    "misfit",
    "not_seen",
    "cameras_disagree",
]


@dataclass(frozen=True)
class TrackingProblem:
    """A problem.

    Attributes:
        camera: the camera's name; empty if it is about all of them.
        marker: the marker's id; None if it is about a camera.
        since_s: when it began, by the fleet's clock.
    """

    kind: ProblemKind
    camera: str
    marker: int | None
    text: str
    since_s: float

    def as_json(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


class ProblemList:
    """The present problems, each with the time at which it began.

    Args:
        on_new: receives each new problem, one that comes and goes once a minute of the fleet's clock.
    """

    def __init__(self, on_new: Callable[[TrackingProblem], None]) -> None:
        self._on_new = on_new
        self._told_s: dict[tuple[ProblemKind, str, int | None], float] = {}
        self._present: dict[tuple[ProblemKind, str, int | None], TrackingProblem] = {}

    @property
    def present(self) -> tuple[TrackingProblem, ...]:
        """The present problems, the oldest first."""
        return tuple(sorted(self._present.values(), key=lambda one: one.since_s))

    def replace(self, kinds: Iterable[ProblemKind], camera: str, found: Iterable[TrackingProblem]) -> None:
        """Replace the problems of some kinds of a camera; those that persist keep their time."""
        wanted = {(one.kind, one.camera, one.marker): one for one in found}
        kept = set(kinds)
        for key in [key for key in self._present if key[0] in kept and key[1] == camera and key not in wanted]:
            del self._present[key]
        for key, problem in wanted.items():
            if key not in self._present:
                self._present[key] = problem
                if problem.since_s - self._told_s.get(key, -math.inf) >= _TOLD_EACH_S:
                    self._told_s[key] = problem.since_s
                    self._on_new(problem)
