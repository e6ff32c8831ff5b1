"""PictureLog: findings in pictures of simulated cameras, so that a run that repeats another one draws none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

Findings: TypeAlias = Mapping[str, Any]
"""The result of a search in a picture, for JSON."""


class PictureLog:
    """Findings in pictures. Thread: any.

    Args:
        on_found: receives each camera, the time of the exposure in seconds of the fleet's clock, and the findings. It
            is called by the thread that reads the camera, and must not block.
        past: the findings of the past that is repeated, by camera and time.
    """

    def __init__(
        self, on_found: Callable[[str, float, Findings], None], past: Mapping[tuple[str, float], Findings] | None = None
    ) -> None:
        self.add = on_found
        self._past = past or {}

    @property
    def has_past(self) -> bool:
        """Whether a past is repeated."""
        return bool(self._past)

    def find(self, camera: str, stamp_s: float) -> Findings | None:
        """Return the findings in a picture of the past; None if there was none at that time."""
        return self._past.get((camera, stamp_s))
