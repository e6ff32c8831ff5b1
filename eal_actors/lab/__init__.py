"""Experiments: calibration, choreography, panoramas, rehearsals and parameter sweeps."""
