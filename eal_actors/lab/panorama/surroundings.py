"""A camera beside the axis: its attitudes, its position and the distances of what stands round it, by all pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from eal_actors.lab.panorama.alignment import align_pixels
from eal_actors.lab.panorama.cylinder import Image, scaled_down
from eal_actors.lab.panorama.depths import depth_map
from eal_actors.lab.panorama.placement import FramePlacement, gains_of
from eal_actors.lab.panorama.ring import ring_of

_WIDTH: Final = 640  # largest width of the compared frames, in pixels: bounds time and memory
_ROUNDS: Final = 2  # attitudes and distances need each other


def with_surroundings(frames: Mapping[int, Image], placement: FramePlacement) -> FramePlacement:
    """Return the placement with better attitudes and position, and with the distances of what stands round the camera.

    That of a camera on the axis, or of an open ring, is returned as it is.

    Thread: any; it may take some seconds.
    """
    places, camera = dict(placement.places), placement.camera
    if not camera.parallax.is_some:
        return placement
    ring = ring_of({number: attitude.yaw_rad for number, attitude in places.items()}, 2 * camera.lens.half_view_rad)
    if not ring.is_closed:
        return placement
    gains = gains_of(placement)
    alike = {number: _brightened(scaled_down(frames[number], _WIDTH), gains[number]) for number in places}
    height, width, _ = next(iter(alike.values())).shape
    small = camera._replace(lens=camera.lens.scaled(width, height))
    for _ in range(_ROUNDS):
        small, places = align_pixels(alike, small, places, ring)
        small = small._replace(parallax=replace(small.parallax, depths=depth_map(alike, small, places, ring)))
    return replace(placement, camera=camera._replace(parallax=small.parallax), places=places)


def _brightened(frame: Image, gain: float) -> Image:
    return np.asarray(np.rint(frame * np.float32(gain)).clip(0, 255), np.uint8)
