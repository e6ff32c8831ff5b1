"""One simulated robot: its body in the physics space and the motion it carries out."""

from __future__ import annotations

import math
import zlib
from typing import Final

import numpy as np
import pymunk

from eal_actors.plugin import UnavailableError

from .models import NO_ERRORS, Make
from .motion import Motion, Wheels

SUBSTEPS: Final = 4
"""Physics steps in a tick, so that a robot that runs into a wall sinks in by a quarter of its travel in a tick."""

_FORCE_MARGIN: Final = 2.0 * SUBSTEPS
"""Greatest drive force over what the accelerations need: a tick's change of speed happens in its first step."""

_FRICTION: Final = 0.3


class SimRobot:
    """A disc that is driven by two wheels, or stands with its brakes on.

    While it stands, its body is kinematic: nothing moves it, not even by a rounding error. For each motion it gets a
    fresh dynamic body, dragged by a control body through two joints of limited force, so that the path depends on
    nothing the physics engine remembers from before.

    Args:
        name: the robot's name.
        make: its make.
        noise: whether its wheels have the errors of its make.
        group: over 0, its own in the world: its rays do not see itself.
        seed: the fleet's seed.
        tick_s: length of a physics tick.

    Attributes:
        motion: what it carries out; None while it stands.
        sensor_generator: the source of all noise of its sensors.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(self, name: str, make: Make, *, noise: bool, group: int, seed: int, tick_s: float) -> None:
        self.name = name
        self.make = make
        self.noise = noise
        self.filter = pymunk.ShapeFilter(group=group)
        self.motion: Motion | None = None
        name_seed = zlib.crc32(name.encode())
        motion_generator, self.sensor_generator = (np.random.default_rng([seed, name_seed, use]) for use in range(2))
        self._wheels = Wheels(make.errors if noise else NO_ERRORS, motion_generator, tick_s)
        self._track_m = make.track_m * (make.errors.track_factor if noise else 1.0)
        self._tick_s = tick_s
        self._space: pymunk.Space | None = None
        self._body: pymunk.Body | None = None
        self._control: pymunk.Body | None = None
        self._parts: list[pymunk.Body | pymunk.Shape | pymunk.Constraint] = []

    @property
    def space(self) -> pymunk.Space:
        """The space it is in.

        Raises:
            UnavailableError: it has no place in the world.
        """
        if self._space is None:
            raise UnavailableError(f"the simulated world has no free place for robot {self.name!r}")
        return self._space

    @property
    def pose(self) -> tuple[float, float, float]:
        """Its true x and y in metres and yaw in radians, unwrapped, in the world's frame.

        Raises:
            UnavailableError: it has no place in the world.
        """
        if self._body is None:
            raise UnavailableError(f"the simulated world has no free place for robot {self.name!r}")
        x_m, y_m = self._body.position
        return x_m, y_m, self._body.angle

    @property
    def is_blocked(self) -> bool:
        """Whether it moves at less than half the speed it is driven at."""
        if self._body is None or self._control is None:
            return False
        arm_m = self.make.track_m / 2
        driven, actual = (
            body.velocity.length + abs(body.angular_velocity) * arm_m for body in (self._control, self._body)
        )
        return bool(actual < driven / 2)

    def place(self, space: pymunk.Space, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Put it into a space, standing."""
        self._space = space
        self._embody(pymunk.Body(body_type=pymunk.Body.KINEMATIC), (x_m, y_m, yaw_rad))

    def start(self, motion: Motion) -> None:
        """Release the brakes and begin a motion.

        Raises:
            UnavailableError: it has no place in the world.
        """
        moment = pymunk.moment_for_circle(self.make.mass_kg, 0.0, self.make.radius_m)
        body = pymunk.Body(self.make.mass_kg, moment)
        self._embody(body, self.pose)
        control = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        control.position, control.angle = body.position, body.angle
        pivot = pymunk.PivotJoint(control, body, (0.0, 0.0), (0.0, 0.0))
        gear = pymunk.GearJoint(control, body, 0.0, 1.0)
        pivot.max_bias = gear.max_bias = 0.0  # the wheels do not make up for what a wall took
        force_n = _FORCE_MARGIN * self.make.mass_kg * self.make.acceleration_m_s2
        pivot.max_force = force_n
        gear.max_force = _FORCE_MARGIN * moment * self.make.acceleration_m_s2 / (self.make.track_m / 2)
        self.space.add(control, pivot, gear)
        self._parts += [control, pivot, gear]
        self._control = control
        self._wheels.start()
        self.motion = motion

    def stop(self) -> None:
        """Put the brakes on: it stands at once."""
        if self.motion is not None:
            self.motion = self._control = None
            self._embody(pymunk.Body(body_type=pymunk.Body.KINEMATIC), self.pose)

    def drive_tick(self) -> None:
        """Set the wheels' speeds for the next physics tick."""
        if self.motion is None or self._body is None or self._control is None:
            return
        if self.motion.is_settling:
            left_m, right_m = self.motion.step()
        else:
            left_m, right_m = self._wheels.travel(*self.motion.step())
        speed_m_s = (left_m + right_m) / (2 * self._tick_s)
        yaw_rad = self._body.angle
        self._control.velocity = speed_m_s * math.cos(yaw_rad), speed_m_s * math.sin(yaw_rad)
        self._control.angular_velocity = (right_m - left_m) / (self._track_m * self._tick_s)

    def _embody(self, body: pymunk.Body, pose: tuple[float, float, float]) -> None:
        self.space.remove(*self._parts)
        body.position, body.angle = pose[:2], pose[2]
        disc = pymunk.Circle(body, self.make.radius_m)
        disc.filter, disc.friction = self.filter, _FRICTION
        self._parts = [body, disc]
        self.space.add(*self._parts)
        self._body = body
