"""The square test (UMBmark): how a base's wheels differ from their nominal sizes, found out and made up for.

`square` is where a robot's square ends, `umbmark` what the ends of many squares say at a glance, `fit` what they say
exactly: all pure. `drive` has a robot drive squares and measures them; `ends_file` and `step` read them from the
records of a run, `calibration_file` writes what was found where the fleet file finds it.
"""

from __future__ import annotations
