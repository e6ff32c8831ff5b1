"""Printed markers: sheets to scale, the ChArUco board, and the lens of a camera from pictures of that board."""
