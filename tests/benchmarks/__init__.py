"""Benchmarks: each prints ratios to a reference that runs in the same process, in turn with it.

Run them all with `make bench`, which also writes docs/benchmarks.md.
"""
