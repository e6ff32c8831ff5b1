"""Choreographies, in YAML and in Python."""
