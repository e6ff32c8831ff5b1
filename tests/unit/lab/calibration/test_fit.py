"""Fit of the calibration to the ends of squares."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.calibration.fit import fit_squares
from eal_actors.lab.calibration.square import SquareEnds, square_end

SIDE_M = 1.0
BASE_M = 0.25


def ends_of(
    truth: WheelCalibration, applied: WheelCalibration = NOMINAL, side_m: float = SIDE_M, base_m: float = BASE_M
) -> SquareEnds:
    """Return the ends of a square each way, of wheels without noise."""
    cw, ccw = (square_end(way, side_m, base_m, truth, applied)[:2] for way in ("cw", "ccw"))
    return SquareEnds([cw], [ccw])


def found(truth: WheelCalibration) -> tuple[float, float]:
    return truth.track_factor, truth.wheel_ratio


def test_the_error_is_that_of_the_farther_centre_of_gravity() -> None:
    ends = SquareEnds([(0.02, 0.04), (0.04, 0.04)], [(-0.01, 0.01), (0.01, -0.01)])
    assert ends.centre("cw") == pytest.approx((0.03, 0.04))
    assert ends.error_m == pytest.approx(0.05)
    # of the mean of two: variances 0.0002 + 0 and 0.0002 + 0.0002
    assert ends.scatter_m == pytest.approx(math.sqrt(0.0002))
    assert SquareEnds([(0, 0)], [(0, 0)]).scatter_m is None


@pytest.mark.parametrize(("e_b", "e_d"), [(1.012, 1.004), (0.985, 0.996), (1.002, 1.0)])
def test_the_fit_agrees_with_the_closed_form_of_the_paper_for_wheels(e_b: float, e_d: float) -> None:
    """To first order: see docs/calibration.md."""
    ends = ends_of(WheelCalibration(track_factor=e_b, wheel_ratio=e_d))
    (x_cw, y_cw), (x_ccw, y_ccw) = ends.centre("cw"), ends.centre("ccw")
    alpha_rad = ((x_cw + x_ccw) + (y_cw - y_ccw)) / (-8 * SIDE_M)
    beta_rad = ((x_cw - x_ccw) + (y_cw + y_ccw)) / (-8 * SIDE_M)
    bend = BASE_M / 2 * math.sin(beta_rad / 2) / (SIDE_M / 2)
    paper = (math.pi / 2 / (math.pi / 2 - alpha_rad), (1 + bend) / (1 - bend))
    assert found(fit_squares(ends, SIDE_M, BASE_M).calibration) == pytest.approx(paper, abs=4e-4)


def test_the_fit_is_exact_for_tracks() -> None:
    fit = fit_squares(ends_of(WheelCalibration(track_factor=1.2, wheel_ratio=1.012)), SIDE_M, BASE_M)
    assert found(fit.calibration) == pytest.approx((1.2, 1.012), abs=1e-9)
    assert fit.left_over_m < 1e-9
    assert 2 <= fit.steps <= 8
    assert not fit.is_doubtful


plausible = st.builds(WheelCalibration, track_factor=st.floats(0.9, 1.4), wheel_ratio=st.floats(0.98, 1.02))


@settings(max_examples=60)
@given(truth=plausible, side_m=st.floats(0.5, 5), base_m=st.floats(0.2, 0.5))
def test_the_fit_finds_what_made_the_ends(truth: WheelCalibration, side_m: float, base_m: float) -> None:
    fit = fit_squares(ends_of(truth, side_m=side_m, base_m=base_m), side_m, base_m)
    assert found(fit.calibration) == pytest.approx(found(truth), abs=1e-7)


@settings(max_examples=60)
@given(
    truth=plausible,
    track_error=st.floats(-0.02, 0.02),
    ratio_error=st.floats(-0.004, 0.004),
)
def test_the_fit_goes_on_from_a_calibration_that_was_nearly_right(
    truth: WheelCalibration, track_error: float, ratio_error: float
) -> None:
    applied = WheelCalibration(
        track_factor=truth.track_factor + track_error, wheel_ratio=truth.wheel_ratio + ratio_error
    )
    fit = fit_squares(ends_of(truth, applied), SIDE_M, BASE_M, applied)
    assert found(fit.calibration) == pytest.approx(found(truth), abs=1e-7)


def test_what_the_kinematics_cannot_explain_is_left_over() -> None:
    truth = WheelCalibration(track_factor=1.012, wheel_ratio=1.004)
    (x_m, y_m), shift_m = ends_of(truth).cw[0], 0.05
    ccw = ends_of(truth).ccw[0]
    moved = [(x_m + shift_m + wiggle_m, y_m) for wiggle_m in (-0.001, 0.0, 0.001)]
    fit = fit_squares(SquareEnds(moved, [ccw] * 3), SIDE_M, BASE_M)
    assert 0.01 < fit.left_over_m < shift_m
    assert fit.is_doubtful


@pytest.mark.parametrize(
    ("cw", "ccw", "says"),
    [
        ([], [(0.0, 0.0)], "no square cw was measured"),
        ([(0.0, 0.0)], [], "no square ccw was measured"),
        ([(0.0, math.nan)], [(0.0, 0.0)], "square 1 cw ended at x 0.0 m, y nan m: not a position"),
    ],
)
def test_ends_that_say_nothing_are_refused(
    cw: list[tuple[float, float]], ccw: list[tuple[float, float]], says: str
) -> None:
    with pytest.raises(ArgumentError, match=says):
        SquareEnds(cw, ccw)


@pytest.mark.parametrize(("side_m", "base_m", "says"), [(0.0, 0.3, "side"), (1.0, -1.0, "wheelbase")])
def test_lengths_that_are_none_are_refused(side_m: float, base_m: float, says: str) -> None:
    ends = SquareEnds([(0.0, 0.0)], [(0.0, 0.0)])
    with pytest.raises(ArgumentError, match=f"the {says} must be over 0 m"):
        fit_squares(ends, side_m, base_m)


@pytest.mark.parametrize("metres", [1.0, 4.0, 1e6])
def test_ends_that_nothing_explains_are_refused(metres: float) -> None:
    ends = SquareEnds([(metres, -metres)], [(-metres, -metres)])
    with pytest.raises(ArgumentError, match=r"no E_b and E_d explain .* remain\. Was the robot blocked"):
        fit_squares(ends, SIDE_M, BASE_M)


@pytest.mark.parametrize("metres", [1.0, 4.0, 1e6])
def test_ends_that_no_base_makes_are_refused(metres: float) -> None:
    ends = SquareEnds([(metres, metres)], [(metres, metres)])
    with pytest.raises(ArgumentError, match=r"the squares give E_b .* which is impossible"):
        fit_squares(ends, SIDE_M, BASE_M)
