"""Benchmarks of `eal prove`."""
