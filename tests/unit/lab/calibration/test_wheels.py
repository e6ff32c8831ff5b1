"""The effect of a calibration on counts and distances."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.device.localization.pose_filter import between
from eal_actors.lab.calibration.square import along_arc, square_end

calibrations = st.builds(WheelCalibration, track_factor=st.floats(0.5, 2.0), wheel_ratio=st.floats(0.9, 1.1))
lengths = st.floats(-100, 100)


def test_the_factors_of_the_wheels_are_those_of_the_paper() -> None:
    calibration = WheelCalibration(wheel_ratio=1.5 / 1.4)  # diameters of 150 and 140 mm
    assert calibration.left_factor == pytest.approx(140 / 145)
    assert calibration.right_factor == pytest.approx(150 / 145)


@given(ahead=lengths, arc=lengths)
def test_nominal_wheels_count_what_they_always_did(ahead: float, arc: float) -> None:
    assert NOMINAL.counted(ahead, arc) == (ahead - arc, ahead + arc)
    assert NOMINAL.travelled(ahead, arc) == ((ahead + arc) / 2, (arc - ahead) / 2)


@given(calibration=calibrations, ahead=lengths, arc=lengths)
def test_what_is_counted_is_travelled(calibration: WheelCalibration, ahead: float, arc: float) -> None:
    back = calibration.travelled(*calibration.counted(ahead, arc))
    assert back == pytest.approx((ahead, arc), abs=1e-9)


@given(calibration=calibrations, side_m=st.floats(0.2, 20), wheelbase_m=st.floats(0.05, 2))
def test_a_base_that_knows_its_wheels_comes_home(
    calibration: WheelCalibration, side_m: float, wheelbase_m: float
) -> None:
    for way, turns in (("cw", -1), ("ccw", 1)):
        x_m, y_m, yaw_rad = square_end(way, side_m, wheelbase_m, calibration, calibration)  # type: ignore[arg-type]
        # a turn in place with unlike wheels goes round a point beside the centre, by so much of the arm at most
        most_m = wheelbase_m / 2 * abs(calibration.right_factor - calibration.left_factor) * 2 + 1e-9
        assert math.hypot(x_m, y_m) <= most_m
        assert yaw_rad == pytest.approx(turns * math.tau)


@given(calibration=st.builds(WheelCalibration, track_factor=st.floats(0.5, 2), wheel_ratio=st.floats(0.92, 1.08)))
def test_a_square_the_other_way_round_with_the_wheels_exchanged_is_its_mirror_image(
    calibration: WheelCalibration,
) -> None:
    exchanged = WheelCalibration(track_factor=calibration.track_factor, wheel_ratio=1 / calibration.wheel_ratio)
    x_m, y_m, yaw_rad = square_end("cw", 1.0, 0.3, calibration)
    assert square_end("ccw", 1.0, 0.3, exchanged) == pytest.approx((x_m, -y_m, -yaw_rad), abs=1e-9)


def test_tracks_that_turn_too_little_end_where_geometry_says() -> None:
    """With E_b of 1.2 each quarter is 75 degrees: the sides are unit steps at 0, 75, 150 and 225 degrees."""
    truth = WheelCalibration(track_factor=1.2)
    steps = [math.radians(angle) for angle in (0, 75, 150, 225)]
    x_m, y_m, yaw_rad = square_end("ccw", 1.0, 0.24, truth)
    assert (x_m, y_m) == pytest.approx((sum(map(math.cos, steps)), sum(map(math.sin, steps))))
    assert yaw_rad == pytest.approx(math.radians(300))


@given(start=st.tuples(lengths, lengths, st.floats(-10, 10)), ahead_m=lengths, turn_rad=st.floats(-3, 3))
def test_what_is_seen_from_a_start_does_not_depend_on_the_start(
    start: tuple[float, float, float], ahead_m: float, turn_rad: float
) -> None:
    seen = between(start, along_arc(start, ahead_m, turn_rad))
    assert seen == pytest.approx(along_arc((0.0, 0.0, 0.0), ahead_m, turn_rad), abs=1e-9)


@pytest.mark.parametrize("wrong", [{"track_factor": 0.4}, {"wheel_ratio": 1.2}, {"track_factor": math.nan}, {"b": 1.0}])
def test_what_no_base_has_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        WheelCalibration.model_validate(wrong)
