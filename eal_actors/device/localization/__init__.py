"""Localization: the pose estimate of a robot, and the filter that computes it from odometry and fixes."""
