"""Maps of the floor and paths on them: plain objects and functions on numpy, without threads.

The frame is `map`, which is the world's frame in the simulation: metres, x east, y north, yaw counter-clockwise from x.
"""

from eal_actors.kernel.errors import UnsupportedError

try:
    import numpy as _numpy  # noqa: F401
except ImportError as error:
    raise UnsupportedError("maps and paths need numpy: pip install 'eal-actors[sim]'") from error
