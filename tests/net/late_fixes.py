"""The fixes that the tracker of test_fixes gives: filled by the test, which runs in the same process."""

from eal_actors.device.data import EALData

FIXES: list[EALData] = []
