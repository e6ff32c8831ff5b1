"""Choreography: formations of a group of robots, and detection of changes in their camera pictures.

Everything is pure except for the scenario steps `plan_formation` and `compare_views`.
"""
