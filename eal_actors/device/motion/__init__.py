"""Closed-loop motion of a two-wheeled robot to a pose: pure controllers, and the activity that runs one."""
