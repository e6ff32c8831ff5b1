"""DifferentialBase: commands, keys and argument checks."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError

from eal_actors.device.data import EALData
from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DifferentialBase,
    Drivetrain,
    MobileBaseSettings,
    Radius,
    UnsupportedError,
    WheelCalibration,
)

TANK = Drivetrain("tank", 0.2, speed_m_s=0.3, max_speed_m_s=0.5, turn_rate_deg_s=60.0, max_turn_rate_deg_s=120.0)


class Base(DifferentialBase):
    """Notes what it is asked for."""

    calibration = WheelCalibration()

    def __init__(self) -> None:
        super().__init__(TANK)
        self.asked: list[tuple[Any, ...]] = []
        self.halts = 0

    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        self.asked.append(("drive", distance_m, speed_m_s))
        yield 0.1

    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        self.asked.append(("turn", math.degrees(angle_rad), math.degrees(turn_rate_rad_s)))
        yield 0.1

    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        self.asked.append(("follow", *self.wheel_speeds_m_s(speed_m_s, turn_rate_rad_s)))
        yield timeout_s

    def halt(self) -> None:
        self.halts += 1


@pytest.fixture
def base() -> Base:
    return Base()


@pytest.mark.parametrize(
    ("cmd", "asked"),
    [
        ("g", ("drive", 0.5, 0.3)),
        ("b", ("drive", -0.5, 0.3)),
        ("f0.25", ("drive", 0.25, 0.3)),
        ("b0.25", ("drive", -0.25, 0.3)),
        ("l", ("turn", 90, 60)),
        ("r", ("turn", -90, 60)),
        ("l30", ("turn", 30, 60)),
        ("r45", ("turn", -45, 60)),
    ],
)
def test_each_command_is_a_motion(base: Base, cmd: str, asked: tuple[str, float, float]) -> None:
    list(base.send_cmd(cmd))

    assert base.asked == [(asked[0], pytest.approx(asked[1]), pytest.approx(asked[2]))]


def test_keys_hold_for_the_next_command(base: Base) -> None:
    for key, value in {"speed_m_s": 0.5, "turn_rate_deg_s": 90.0, "step_m": 1.0}.items():
        base.set_config(key, EALData.of(value))
        assert base.get_config(key) == value
    list(base.send_cmd("g"))
    list(base.send_cmd("l"))

    assert base.asked == [("drive", 1.0, 0.5), ("turn", pytest.approx(90), pytest.approx(90))]


@pytest.mark.parametrize(("key", "most"), [("speed_m_s", 0.5), ("turn_rate_deg_s", 120.0)])
def test_speeds_reach_as_far_as_the_drivetrain(base: Base, key: str, most: float) -> None:
    assert base.info().config(key).value.maximum == most
    with pytest.raises(ArgumentError, match=key):
        base.set_config(key, EALData.of(most * 1.01))


@pytest.mark.parametrize("twist", [(0.51, 0.0), (0.0, -2.1), (math.nan, 0.0), (0.1, math.inf)])
def test_a_twist_out_of_reach_is_refused_before_anything_moves(base: Base, twist: tuple[float, float]) -> None:
    with pytest.raises(ArgumentError, match="which the tank reaches"):
        base.set_value(EALData.of(twist))

    assert base.asked == []


def test_a_curve_too_fast_for_one_wheel_is_driven_slower(base: Base) -> None:
    list(base.set_value(EALData.of((0.5, 1.0))))  # the right wheel would need 0.6 m/s

    assert base.asked == [("follow", pytest.approx(0.4 / 1.2), pytest.approx(0.5))]


def test_a_calibration_is_what_the_wheels_are_told(base: Base) -> None:
    base.set_config("track_factor", EALData.of(1.5))
    base.set_config("wheel_ratio", EALData.of(1.02))
    list(base.set_value(EALData.of((0.0, 1.0))))

    assert base.calibration == WheelCalibration(track_factor=1.5, wheel_ratio=1.02)
    assert base.asked == [("follow", pytest.approx(-0.15 * 1.01), pytest.approx(0.15 * 1.01 / 1.02))]


def test_a_robot_that_calibrates_its_own_wheels_takes_no_calibration() -> None:
    class Vehicle(Base):
        calibration = DifferentialBase.calibration  # not that of Base

    vehicle = Vehicle()
    vehicle.set_config("track_factor", EALData.of(1.0))

    with pytest.raises(UnsupportedError, match="type tank calibrates its own wheels"):
        vehicle.set_config("track_factor", EALData.of(1.5))
    assert vehicle.calibration == WheelCalibration()


def test_settings_of_size_and_speed_make_a_drivetrain() -> None:
    class Settings(MobileBaseSettings):
        radius_m: Radius = 0.25

    drivetrain = Settings(max_speed_m_s=2.0).drivetrain("cart", track_m=0.4)

    assert drivetrain == Drivetrain("cart", 0.4, 0.5, 2.0, 45.0, 120.0, acceleration_m_s2=0.4, radius_m=0.25)
    with pytest.raises(ValidationError, match="radius_m"):
        Settings(radius_m=0.0)


def test_stop_halts(base: Base) -> None:
    base.send_cmd("s")

    assert base.halts == 1


def test_a_driver_without_its_motions_cannot_be_made() -> None:
    class Unfinished(DifferentialBase):
        pass

    with pytest.raises(TypeError, match=r"drive.*follow.*turn"):
        Unfinished(TANK)  # type: ignore[abstract]


def test_a_motion_tells_its_path_until_it_ends(base: Base) -> None:
    def motion() -> Activity:
        yield 0.1
        return 1

    def path() -> list[float]:
        return list(base.send_req("path").value)

    assert path() == []
    running = base.along([(0.0, 0.0), (0.0, 2.0), (-1.0, 2.0)], None, motion())
    next(running)
    assert path() == pytest.approx([0.0, 0.0, math.pi / 2, 0.0, 2.0, math.pi, -1.0, 2.0, math.pi])
    running.close()
    assert path() == []
    goal = base.along([(0.0, 0.0), (1.0, 0.0)], 0.5, motion())
    next(goal)
    assert path() == [0.0, 0.0, 0.0, 1.0, 0.0, 0.5]
    with pytest.raises(StopIteration):
        next(goal)
    assert path() == []
