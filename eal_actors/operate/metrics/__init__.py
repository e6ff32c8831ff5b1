"""Prometheus metrics of the robots that this process runs or commands."""
