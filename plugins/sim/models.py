"""The makes of robots that can be simulated: their sizes, speeds, errors and batteries.

The wheels' errors are what is left after a calibration. What a robot errs before one stands beside them: a tracked
base then turns about 17 % too little (a track factor of 1.2), for its tracks skid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal

MakeName = Literal["evbot2", "evbot3", "roomba"]


@dataclass(frozen=True, slots=True)
class WheelErrors:
    """How a robot's true motion differs from what its wheel encoders count.

    Attributes:
        k_left: travel of the left wheel per metre counted.
        k_right: travel of the right wheel per metre counted.
        track_factor: effective over nominal track: over 1 the robot turns too little (E_b of Borenstein and Feng).
        walk: each wheel's factor also wanders from 1 during a motion, by this standard deviation after 1 s.
    """

    k_left: float = 1.0
    k_right: float = 1.0
    track_factor: float = 1.0
    walk: float = 0.0

    @classmethod
    def of_umbmark(cls, e_b: float, e_d: float, walk: float) -> WheelErrors:
        """Return the errors that the UMBmark test tells as E_b and E_d, the right wheel's diameter over the left's."""
        return cls(2.0 / (e_d + 1.0), 2.0 / (1.0 / e_d + 1.0), e_b, walk)


@dataclass(frozen=True, slots=True)
class BatteryModel:
    """A battery and what the robot draws from it.

    Attributes:
        capacity_ah: what it holds when full.
        empty_v: its voltage without load when it is empty.
        flat_v: its voltages without load at 10 % and at 90 %, between which it falls evenly.
        full_v: its voltage without load when it is full.
        resistance_ohm: by which its voltage sags under a current.
        idle_a: what the robot draws while it stands.
        drive_as_m: what driving draws besides, in ampere-seconds per metre that the wheels turn on the average.
    """

    capacity_ah: float
    empty_v: float
    flat_v: tuple[float, float]
    full_v: float
    resistance_ohm: float
    idle_a: float
    drive_as_m: float


@dataclass(frozen=True, slots=True)
class TurretModel:
    """A turret that turns on its robot without end.

    Attributes:
        turn_rate_deg_s: turn rate at first.
        max_turn_rate_deg_s: greatest turn rate.
        acceleration_deg_s2: speeding up and slowing down.
    """

    turn_rate_deg_s: float
    max_turn_rate_deg_s: float
    acceleration_deg_s2: float


@dataclass(frozen=True, slots=True)
class Make:
    """A make of robot: a disc with two driven wheels or tracks, turning about its centre.

    Attributes:
        name: as the settings spell it.
        radius_m: of the disc.
        height_m: from the floor to its top.
        mass_kg: of the whole robot.
        track_m: nominal distance of the wheels.
        speed_m_s: speed at first.
        max_speed_m_s: greatest speed, of each wheel too.
        turn_rate_deg_s: turn rate at first.
        max_turn_rate_deg_s: greatest turn rate.
        acceleration_m_s2: of each wheel, speeding up and slowing down.
        push_n: the force with which it pushes at most, before its wheels slip.
        encoder_step_m: travel of a wheel from one step of its encoder to the next.
        errors: of its wheels, after a calibration.
        raw_errors: of its wheels before one.
        turn_noise_rad: standard deviation of the angle of each turn in place, besides the wheels' errors.
        battery: its battery.
        body_colour: red, green and blue.
        camera_height_m: of its camera over the floor.
        turret: its turret, if it has one.
    """

    name: MakeName
    radius_m: float
    height_m: float
    mass_kg: float
    track_m: float
    speed_m_s: float
    max_speed_m_s: float
    turn_rate_deg_s: float
    max_turn_rate_deg_s: float
    acceleration_m_s2: float
    push_n: float
    encoder_step_m: float
    errors: WheelErrors
    raw_errors: WheelErrors
    turn_noise_rad: float
    battery: BatteryModel
    body_colour: tuple[int, int, int]
    camera_height_m: float
    turret: TurretModel | None = None

    @property
    def has_turret(self) -> bool:
        """Whether it has a turret."""
        return self.turret is not None

    def uncalibrated(self) -> Make:
        """Return the same make with the errors from before a calibration."""
        return replace(self, errors=self.raw_errors)

    def without_errors(self) -> Make:
        """Return the same make with perfect wheels."""
        return replace(self, errors=WheelErrors(), turn_noise_rad=0.0)


MAKES: Final = MappingProxyType(
    {
        make.name: make
        for make in (
            Make(
                name="evbot2",
                radius_m=0.18,
                height_m=0.25,
                mass_kg=4.0,
                track_m=0.24,
                speed_m_s=0.25,
                max_speed_m_s=0.4,
                turn_rate_deg_s=60.0,
                max_turn_rate_deg_s=120.0,
                acceleration_m_s2=0.5,
                push_n=16.0,
                encoder_step_m=0.0005,
                errors=WheelErrors(1.003, 0.998, 1.02, 0.004),
                raw_errors=WheelErrors.of_umbmark(1.2, 1.012, 0.004),
                turn_noise_rad=0.006,
                battery=BatteryModel(4.5, 10.5, (11.6, 12.6), 13.2, 0.15, 0.9, 5.0),
                body_colour=(70, 80, 95),
                camera_height_m=0.22,
            ),
            Make(
                name="evbot3",
                radius_m=0.20,
                height_m=0.45,
                mass_kg=6.0,
                track_m=0.30,
                speed_m_s=0.35,
                max_speed_m_s=0.6,
                turn_rate_deg_s=90.0,
                max_turn_rate_deg_s=150.0,
                acceleration_m_s2=0.8,
                push_n=18.0,
                encoder_step_m=0.0002,
                errors=WheelErrors(1.001, 0.999, 0.993, 0.002),
                raw_errors=WheelErrors.of_umbmark(0.985, 0.996, 0.002),
                turn_noise_rad=0.003,
                battery=BatteryModel(7.2, 10.5, (11.8, 12.7), 13.4, 0.1, 1.5, 4.0),
                body_colour=(200, 120, 40),
                camera_height_m=0.40,
                turret=TurretModel(90.0, 180.0, 360.0),
            ),
            Make(
                name="roomba",
                radius_m=0.17,
                height_m=0.09,
                mass_kg=2.9,
                track_m=0.258,
                speed_m_s=0.30,
                max_speed_m_s=0.5,
                turn_rate_deg_s=90.0,
                max_turn_rate_deg_s=180.0,
                acceleration_m_s2=0.8,
                push_n=9.0,
                encoder_step_m=0.0005,
                errors=WheelErrors(0.998, 1.002, 1.006, 0.0012),
                raw_errors=WheelErrors.of_umbmark(1.012, 1.004, 0.0012),
                turn_noise_rad=0.002,
                battery=BatteryModel(2.7, 12.0, (14.2, 15.8), 16.8, 0.2, 0.25, 2.5),
                body_colour=(225, 225, 220),
                camera_height_m=0.12,
            ),
        )
    }
)
