"""The EvBots' drivers over wires that damage bytes: `ok` is true, and nothing moves on.

`series.py` is the long form.
"""

from __future__ import annotations

import pytest

from tests.fuzz.evbot_drivers import EVBOT_DRIVERS
from tests.fuzz.motions import FuzzedDriver, FuzzTable, fuzz
from tests.fuzz.noisy_wire import Noise

SEED = 1000
DRIVERS = pytest.mark.parametrize("driver", EVBOT_DRIVERS, ids=lambda driver: driver.name)


def _check(driver: FuzzedDriver, table: FuzzTable) -> None:
    print(f"{driver.name}: {table}")  # noqa: T201  # the table of the long form
    assert not table.wrong, "\n".join([str(table), *(f"seed {seed}: {result}" for seed, result in table.wrong)])
    assert table.answers["ok"] > 0
    assert table.faults


@DRIVERS
def test_damaged_bytes_never_become_wrong_motions(driver: FuzzedDriver) -> None:
    _check(driver, fuzz(driver, 10, SEED, Noise(0.005)))
