"""Experiments: calibration, changes between pictures, panoramas, rehearsals and parameter sweeps."""
