"""Scenarios, in YAML and in Python."""
