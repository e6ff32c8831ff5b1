"""What the sensors of all robots in one world share, such as arrays of all that stands in it."""

from __future__ import annotations

from typing import Any, Final, TypeVar
from weakref import WeakKeyDictionary

from ..world import SimWorld

_T = TypeVar("_T")

_SHARED: Final[WeakKeyDictionary[SimWorld, dict[type, Any]]] = WeakKeyDictionary()
"""It goes with its world, which it must therefore not hold; nor a robot, which holds its world."""


def shared(world: SimWorld, kind: type[_T]) -> _T:
    """Return the world's one object of a class, made without arguments for the first who asks.

    Thread: inside `caught_up`.
    """
    objects = _SHARED.setdefault(world, {})
    if kind not in objects:
        objects[kind] = kind()
    found: _T = objects[kind]
    return found
