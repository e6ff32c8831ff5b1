"""Panoramas: stitching of the frames that a camera took while its robot turned in place.

The direction of each frame comes from odometry and is corrected by the overlaps of the frames (Source: thesis §6.2.2,
which takes the frames for stitching). Needs NumPy and OpenCV, the extra `vision`.
"""

from eal_actors.lab.panorama.cylinder import PlacedBy
from eal_actors.lab.panorama.stitching import Panorama, stitch

__all__ = ["Panorama", "PlacedBy", "stitch"]
