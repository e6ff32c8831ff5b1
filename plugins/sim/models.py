"""The makes of simulated robots: their sizes, speeds, errors and batteries.

`errors` are the wheel errors that remain after a calibration, `raw_errors` those before it. An uncalibrated tracked
base turns about 17 % too little (a track factor of 1.2), because its tracks skid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal

from eal_actors.plugin import OdometryNoise

MakeName = Literal["evbot2", "evbot3", "roomba"]

_SCALE_SHARE: Final = 0.005
_HEAD_SHARE: Final = 0.62  # of the radius
_BASE_SHARE: Final = 0.55  # of the height
_POST_M: Final = 0.035
_ABOVE_CAMERA_M: Final = 0.02


@dataclass(frozen=True, slots=True)
class WheelErrors:
    """The difference between a robot's true motion and its encoder counts.

    Attributes:
        k_left: travel of the left wheel per metre counted.
        k_right: travel of the right wheel per metre counted.
        track_factor: effective over nominal track: over 1 the robot turns too little (E_b of Borenstein and Feng).
        scatter_m: random error of each wheel's travel: its standard deviation after 1 m. It grows with the square root
            of the distance.
    """

    k_left: float = 1.0
    k_right: float = 1.0
    track_factor: float = 1.0
    scatter_m: float = 0.0

    @classmethod
    def of_umbmark(cls, e_b: float, e_d: float, scatter_m: float) -> WheelErrors:
        """Return the errors of UMBmark factors E_b and E_d, the right wheel's diameter over the left's."""
        return cls(2.0 / (e_d + 1.0), 2.0 / (1.0 / e_d + 1.0), e_b, scatter_m)


@dataclass(frozen=True, slots=True)
class BatteryModel:
    """A battery and the robot's power consumption.

    Attributes:
        capacity_ah: full charge.
        empty_v: its voltage without load when it is empty.
        flat_v: its voltages without load at 10 % and at 90 %, linear in between.
        full_v: its voltage without load when it is full.
        idle_a: current of the standing robot.
        drive_as_m: additional charge for driving, in ampere-seconds per metre of mean wheel travel.
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
    """A turret that rotates without end stops.

    Attributes:
        turn_rate_deg_s: initial turn rate.
    """

    turn_rate_deg_s: float
    max_turn_rate_deg_s: float
    acceleration_deg_s2: float


@dataclass(frozen=True, slots=True)
class Make:
    """A make of robot: a disc with two driven wheels or tracks, which turns about its centre.

    Attributes:
        name: as in the settings.
        radius_m: of the disc.
        height_m: from the floor to its top.
        mass_kg: of the whole robot.
        track_m: nominal distance of the wheels.
        speed_m_s: initial speed.
        max_speed_m_s: greatest speed, also of each wheel.
        turn_rate_deg_s: initial turn rate.
        acceleration_m_s2: acceleration and deceleration of each wheel.
        push_n: greatest push force before its wheels slip.
        encoder_step_m: travel of a wheel from one step of its encoder to the next.
        errors: wheel errors after a calibration.
        raw_errors: wheel errors before a calibration.
        turn_noise_rad: standard deviation of each turn in place, in addition to the wheel errors.
        body_colour: red, green and blue.
        camera_height_m: of its camera over the floor.
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
    def odometry_noise(self) -> OdometryNoise:
        """The errors of the odometry of robots of this make before a calibration, as far as the make tells."""
        raw = self.raw_errors
        return OdometryNoise(
            self.track_m,
            self.errors.scatter_m,
            self.turn_noise_rad,
            scale_share=_SCALE_SHARE,
            drift_rad_m=abs(raw.k_right - raw.k_left) / self.track_m,
            turn_share=abs(1.0 - 1.0 / raw.track_factor),
        )

    def uncalibrated(self) -> Make:
        """Return the same make with the errors from before a calibration."""
        return replace(self, errors=self.raw_errors)

    def without_errors(self) -> Make:
        """Return the same make with perfect wheels."""
        return replace(self, errors=WheelErrors(), turn_noise_rad=0.0)


def outline_m(radius_m: float, height_m: float, camera_height_m: float) -> tuple[tuple[float, float], ...]:
    """Return the discs that a robot consists of, each its radius and the height of its top, from below.

    A robot that is higher than wide has a head; a low one has a post if its camera is above its top.
    """
    if height_m > radius_m:
        return (radius_m, height_m * _BASE_SHARE), (radius_m * _HEAD_SHARE, height_m)
    if camera_height_m > height_m:
        return (radius_m, height_m), (_POST_M, camera_height_m + _ABOVE_CAMERA_M)
    return ((radius_m, height_m),)


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
                errors=WheelErrors(1.001, 0.999, 0.993, 0.001),
                raw_errors=WheelErrors.of_umbmark(0.985, 0.996, 0.001),
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
                errors=WheelErrors(0.998, 1.002, 1.006, 0.0008),
                raw_errors=WheelErrors.of_umbmark(1.012, 1.004, 0.0008),
                turn_noise_rad=0.002,
                battery=BatteryModel(2.7, 12.0, (14.2, 15.8), 16.8, 0.2, 0.25, 2.5),
                body_colour=(225, 225, 220),
                camera_height_m=0.12,
            ),
        )
    }
)
