"""The simulated camera: perspective images of a world and its moving objects.

A camera is level, so a column of the image is a vertical half plane of the room: walls and the sides of solids have one
depth in each column, floors have one in each row. Flat surfaces are warped by their homographies, round ones column by
column, from mipmaps. Nearer objects are painted over farther ones. Nothing here knows physics, robots or resources.

This package itself imports without numpy and OpenCV; `scene` and `render` need both.
"""
