"""Panoramas of the laboratory against what rays say, at 60 degrees field of view, steps of 45, yaw noise of 2."""

from __future__ import annotations

import math
import sys

import pytest

from eal_actors.lab.panorama import stitch
from tests.unit.lab.panorama import turning
from tests.unit.plugins.sim.ray_caster import psnr_db


def check_seed(seed: int, width: int) -> None:
    meant_rad = turning.steps()
    true_rad = turning.noisy(meant_rad, seed)
    frames = turning.shots(true_rad, width)
    panorama = stitch(frames, meant_rad, turning.VIEW_RAD)
    perfect = turning.truth(panorama, true_rad)
    alone = turning.by_odometry_alone(frames, meant_rad)
    alone_db = psnr_db(alone.image, turning.truth(alone, true_rad, rays_per_side=1))

    reached_db, alike = psnr_db(panorama.image, perfect), turning.ssim(panorama.image, perfect)
    yaw_error_deg = math.degrees(turning.yaw_error_rad(panorama, true_rad))
    figures = (
        f"seed {seed}: {reached_db:.1f} dB, SSIM {alike:.3f}, yaw {yaw_error_deg:.3f} deg; alone {alone_db:.1f} dB"
    )
    sys.stdout.write(figures + "\n")
    assert not panorama.unplaced
    assert panorama.is_full
    assert reached_db >= 28
    assert alike >= 0.94
    assert reached_db >= alone_db + 8
    assert yaw_error_deg < 0.05


@pytest.mark.slow
def test_a_small_panorama_agrees_with_the_rays() -> None:
    check_seed(seed=1, width=320)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_panoramas_agree_with_the_rays(seed: int) -> None:
    check_seed(seed, width=640)
