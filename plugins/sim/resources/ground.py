"""What a robot with cliff sensors does where the floor ends: it halts by itself, as a real one's driver has it halt."""

from __future__ import annotations

from typing import Final

from eal_actors.plugin import ResourceFaultError

from ..robot import SimRobot
from ..sensors import dropped_wheels, seen_cliffs
from ..world import SimWorld

LOOK_S: Final = 0.05
"""How often it looks while it moves: as often as a driver polls a real one."""


def minds_ground(world: SimWorld, robot: SimRobot) -> bool:
    """Return whether a robot has cliff sensors, and its world something for them to see."""
    return robot.make.name == "roomba" and bool(world.model.drops)


def require_ground(world: SimWorld, robot: SimRobot, *, forward: bool) -> None:
    """Require floor under the wheels, and ahead for a way forward. Thread: inside the world's `caught_up`.

    Raises:
        ResourceFaultError: a wheel has dropped, or a cliff lies where the robot is to go.
        UnavailableError: the robot has no place in the world.
    """
    wheels = dropped_wheels(world, robot)
    if any(wheels):
        names = zip(("left wheel", "right wheel", "caster"), wheels, strict=True)
        raise ResourceFaultError(f"halted: wheel drop ({', '.join(name for name, is_so in names if is_so)})")
    cliffs = seen_cliffs(world, robot)
    if forward and any(cliffs):
        seen = (name.replace("_", " ") for name, is_so in cliffs._asdict().items() if is_so)
        raise ResourceFaultError(f"halted: cliff ({', '.join(seen)})")
