"""Calibration of a differential base by the square test (UMBmark).

`square` computes where a square ends, `fit` computes the calibration from the ends of measured squares; both are pure.
`drive` drives and measures squares, `square_ends` holds and stores the ends, `calibration_file` adds the result to a
fleet, and `step` is the scenario step `fit_umbmark`.
"""
