"""The simulated camera: perspective frames of a world and of what moves in it.

A camera stands level, so a column of the image is a vertical half plane of the room: walls and the sides of solids have
one depth in each column, floors have one in each row. Flat surfaces are warped by their homographies, round ones
column by column, from textures that are filtered beforehand for each distance. What stands nearer is painted over what
is farther. Nothing here knows of physics, robots or resources.

Importing this package itself needs neither numpy nor OpenCV; `scene` and `render` do.
"""
