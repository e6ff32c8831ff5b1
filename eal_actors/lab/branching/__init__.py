"""Branches of a recorded run with another future, and the version that changed its record.

A run at `--rate max` repeats to the bit. So `branch` repeats it up to a time and changes something then; `bisect`
repeats it with other versions of its scenario, or of the framework.
"""
