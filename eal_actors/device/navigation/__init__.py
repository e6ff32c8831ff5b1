"""Maps of the floor and paths on them: plain objects and functions on numpy, without threads.

The frame is `map`, which is the world's frame in the simulation: metres, x east, y north, yaw counter-clockwise from x.
"""
