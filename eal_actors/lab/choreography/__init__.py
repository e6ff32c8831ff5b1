"""Choreography: where the robots of a group go and in which order, and what has changed where they look.

All of it is pure but the two scenario steps, `plan_formation` and `compare_views`.
"""
