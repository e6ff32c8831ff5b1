"""Poses of 20 driving robots by one simulated camera above the floor: errors, and time on one core.

The lens is not the true one, but one that `eal calibrate camera` found.
"""

from __future__ import annotations

import os
import time

import cv2
import numpy as np

from tests.benchmarks.camera import one_thread
from tests.benchmarks.result import Result
from tests.unit.plugins.tracker.rig import Arena, groups, world_model

SEEDS, PICTURES, FAST_PICTURES, ROBOTS = int(os.environ.get("GO_SEEDS", "20")), 30, 8, 20
CAMERA = {
    "y_m": -0.27,
    "z_m": 3.4,
    "tilt_deg": 5.0,
    "fov_deg": 68.0,
    "distortion": (-0.22, 0.06, 0.0008, -0.0006, 0.0),
    "noise": 4.0,
    "blur_px": 0.6,
}
LENS = {
    "size_px": (1280, 960),
    "focal_px": (948.80, 948.79),
    "centre_px": (639.36, 479.62),
    "distortion": (-0.220096, 0.060849, 0.000839, -0.000600, -0.001502),
}
"""Of fleets/arena.yaml: fitted to 26 pictures of a board by the camera above."""


EXPOSURES_S = (0.0, 0.01, 0.02)
"""Exposures with which the effect of motion blur is measured: 0.4 m/s is 0.12 pixels in a millisecond."""
FAST_M_S = 0.4


class _Run:
    """The figures of all seeds.

    Args:
        exposure_s: of the camera.
        speed_m_s: of robots that drive straight; None for circles.
    """

    def __init__(self, exposure_s: float = 0.0, speed_m_s: float | None = None) -> None:
        self.camera = {**CAMERA, "exposure_s": exposure_s}
        self.speed_m_s = speed_m_s
        self.places_m: list[float] = []
        self.yaws_deg: list[float] = []
        self.expected = 0
        self.ours_s: list[float] = []
        self.reference_s: list[float] = []

    def add(self, seed: int) -> None:
        """Drive 20 robots for a second, and compare each fix with the truth at its exposure."""
        cameras = {"ceiling": {"source": "sim://world/ceiling", "lens": LENS}}
        arena = Arena(ROBOTS, seed, world_model({"ceiling": self.camera}), cameras=cameras, markers=groups(ROBOTS))
        if self.speed_m_s is None:
            arena.drive()
        else:
            arena.drive_straight(self.speed_m_s)
        feed = arena.tracker.cameras["ceiling"]
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
        for _ in range(PICTURES if self.speed_m_s is None else FAST_PICTURES):
            arena.clock.advance(1 / 30)
            picture, stamp_s = arena.camera("ceiling").newest()
            begun_s = time.process_time()
            feed.process(picture, stamp_s)
            self.ours_s.append(time.process_time() - begun_s)
            away = arena.errors(arena.tracker.fixes())
            self.expected += ROBOTS
            self.places_m += np.hypot(away[:, 0], away[:, 1]).tolist()
            self.yaws_deg += np.degrees(np.abs(away[:, 2])).tolist()
            grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            begun_s = time.process_time()
            detector.detectMarkers(grey)
            self.reference_s.append(time.process_time() - begun_s)


def run() -> list[Result]:
    """Return the figures."""
    return [*_sharp(), *(result for exposure_s in EXPOSURES_S for result in _blurred(exposure_s))]


def _blurred(exposure_s: float) -> list[Result]:
    """Return the errors of fast robots in pictures with a long exposure."""
    done = _Run(exposure_s, FAST_M_S)
    with one_thread():
        for seed in range(1, SEEDS + 1):
            done.add(seed)
    place_mm, yaw_deg = np.percentile(done.places_m, 95) * 1000, np.percentile(done.yaws_deg, 95)
    what = f"exposed for {exposure_s * 1000:.0f} ms at {FAST_M_S} m/s"
    worst = f"worst {max(done.places_m) * 1000:.1f} mm, {max(done.yaws_deg):.2f} deg"
    found = len(done.places_m)
    return [
        Result(f"{what}: place, p95", f"{place_mm:.2f} mm, {yaw_deg:.3f} deg", worst, float(place_mm), 5.0, "mm"),
        Result(f"{what}: found", f"{found} of {done.expected}", "those in view", found / done.expected, 0.99, "", True),
    ]


def _sharp() -> list[Result]:
    """Return the errors and the time with pictures of one instant."""
    done = _Run()
    with one_thread():
        for seed in range(1, SEEDS + 1):
            done.add(seed)
    place_mm, yaw_deg = np.percentile(done.places_m, 95) * 1000, np.percentile(done.yaws_deg, 95)
    found, ours_ms, reference_ms = len(done.places_m), np.mean(done.ours_s) * 1e3, np.mean(done.reference_s) * 1e3
    what = f"tracked pose, {ROBOTS} driving robots, {SEEDS} seeds"
    worst = f"worst {max(done.places_m) * 1000:.1f} mm, {max(done.yaws_deg):.2f} deg"
    whole = f"cv2 detectMarkers, whole picture: {reference_ms:.1f} ms"
    return [
        Result(f"{what}: place, p95", f"{place_mm:.2f} mm", worst, float(place_mm), 5.0, "mm"),
        Result(f"{what}: yaw, p95", f"{yaw_deg:.3f} deg", worst, float(yaw_deg), 1.0, "deg"),
        Result("markers found", f"{found} of {done.expected}", "those in view", found / done.expected, 1.0, "", True),
        Result("a picture of 1280 x 960 on one core", f"{ours_ms:.1f} ms", whole, float(ours_ms / reference_ms), 1.0),
        Result(
            "pictures in a second of one core", f"{1e3 / ours_ms:.0f}", whole, float(1e3 / ours_ms), 30.0, "/s", True
        ),
    ]
