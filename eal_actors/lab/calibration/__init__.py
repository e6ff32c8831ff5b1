"""Calibration of a differential base by the square test (UMBmark).

`square` computes where a square ends and stores the measured ends, `fit` computes the calibration from them, `drive`
drives and measures squares, `calibration_file` adds the result to a fleet, and `step` is the step `fit_umbmark`.
"""
