"""The drivers whose wires are fuzzed, by name."""

from __future__ import annotations

from typing import Final

from tests.fuzz.evbot_drivers import EVBOT_DRIVERS
from tests.fuzz.roomba_drivers import ROOMBA_DRIVERS

DRIVERS: Final = {driver.name: driver for driver in (*ROOMBA_DRIVERS, *EVBOT_DRIVERS)}
