"""TransformTree: the newest transform of each frame to its parent, and the way between two frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

from eal_actors.plugin import ArgumentError, DataError

from .endpoints import RosSubscription

_MOST_FRAMES: Final = 1000

Numbers = tuple[float, float, float]
Rotation = tuple[float, float, float, float]
Transform = tuple[Numbers, Rotation]
"""Translation in m, and the quaternion x, y, z, w."""
_IDENTITY: Final[Transform] = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)


class TransformTree:
    """The tree of frames from `/tf` and `/tf_static`. Thread: one at a time."""

    def __init__(self, subscriptions: Sequence[RosSubscription]) -> None:
        self._subscriptions = subscriptions
        self._frames: dict[str, tuple[str, Transform]] = {}

    def refresh(self) -> None:
        """Take the messages that have arrived; transforms that are no rotations and finite numbers are ignored."""
        for subscription in self._subscriptions:
            for message in _all(subscription):
                for stamped in message.transforms:
                    self._follow(stamped)

    def _follow(self, stamped: Any) -> None:
        move, turn = stamped.transform.translation, stamped.transform.rotation
        length = math.hypot(turn.x, turn.y, turn.z, turn.w)
        numbers = move.x, move.y, move.z
        if not all(map(math.isfinite, (*numbers, length))) or not 0.9 < length < 1.1:
            return
        rotation = turn.x / length, turn.y / length, turn.z / length, turn.w / length
        child = stamped.child_frame_id.strip("/")
        if child in self._frames or len(self._frames) < _MOST_FRAMES:
            self._frames[child] = stamped.header.frame_id.strip("/"), (numbers, rotation)

    def parents(self) -> dict[str, str]:
        """Return each frame's parent."""
        return {child: parent for child, (parent, _) in sorted(self._frames.items())}

    def lookup(self, target: str, source: str) -> list[float]:
        """Return x, y, z and the quaternion x, y, z, w of the source frame in the target frame.

        Raises:
            ArgumentError: no chain of transforms connects them.
        """
        to_target, to_source = self._to_root(target), self._to_root(source)
        common = next((frame for frame in to_source if frame in to_target), None)
        if common is None:
            known = ", ".join(sorted({*self._frames, *self.parents().values()}))
            raise ArgumentError(f"no transforms connect {target!r} and {source!r}; known frames are {known or 'none'}")
        move, turn = _compose(_inverse(to_target[common]), to_source[common])
        return [*move, *turn]

    def _to_root(self, frame: str) -> dict[str, Transform]:
        """Return the pose of a frame in each of its ancestors, and in itself."""
        found = {frame: _IDENTITY}
        pose = _IDENTITY
        while frame in self._frames:
            frame, step = self._frames[frame]
            if frame in found:  # a circle
                break
            pose = _compose(step, pose)
            found[frame] = pose
        return found


def _all(subscription: RosSubscription) -> Iterator[Any]:
    while True:
        try:
            received = subscription.take()
        except DataError:
            continue
        if received is None:
            return
        yield received.message


def _rotate(rotation: Rotation, vector: Numbers) -> Numbers:
    x, y, z, w = rotation
    tx, ty, tz = (
        2 * (y * vector[2] - z * vector[1]), 2 * (z * vector[0] - x * vector[2]), 2 * (x * vector[1] - y * vector[0])
    )  # fmt: skip
    return (
        vector[0] + w * tx + y * tz - z * ty,
        vector[1] + w * ty + z * tx - x * tz,
        vector[2] + w * tz + x * ty - y * tx,
    )


def _compose(first: Transform, second: Transform) -> Transform:
    """Return the second transform, seen from before the first."""
    (x1, y1, z1, w1), (x2, y2, z2, w2) = first[1], second[1]
    turned = _rotate(first[1], second[0])
    move = first[0][0] + turned[0], first[0][1] + turned[1], first[0][2] + turned[2]
    rotation = (
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )
    return move, rotation


def _inverse(transform: Transform) -> Transform:
    (x, y, z), (qx, qy, qz, qw) = transform
    back: Rotation = -qx, -qy, -qz, qw
    moved = _rotate(back, (x, y, z))
    return (-moved[0], -moved[1], -moved[2]), back
