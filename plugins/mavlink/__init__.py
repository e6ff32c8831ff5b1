"""Rovers and drones by MAVLink."""
