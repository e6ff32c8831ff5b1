"""A network camera over the floor of a simulated world, for `eal lab`."""

from __future__ import annotations

from typing import Final

from eal_actors.plugin import PluginContext

from ..camera.streaming import PictureStream

_MOST_AGE_S: Final = 0.1  # robots drive on meanwhile, and the driver knows its camera's delay


def emulate_in_world(context: PluginContext, url: str) -> PictureStream:
    """Return the server of a simulated camera."""
    return PictureStream(context.simulated_camera(url), context.clock, _MOST_AGE_S)
