"""Panoramas: frames that a camera took while its robot turned in place become one seamless picture.

Where each frame looks comes from odometry and is corrected by what the frames show where they overlap (Source: thesis
§6.2.2, which takes the frames, as might be used for stitching). Needs NumPy and OpenCV, the extra `vision`.
"""

from eal_actors.lab.panorama.shift import How
from eal_actors.lab.panorama.stitching import Panorama, stitch

__all__ = ["How", "Panorama", "stitch"]
