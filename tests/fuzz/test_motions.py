"""Motions over wires that damage bytes: what a driver answers is true, and nothing moves on.

`make fuzz-motions` runs the long form and prints its table.
"""

from __future__ import annotations

import pytest

from tests.fuzz.drivers import DRIVERS
from tests.fuzz.motions import FuzzTable, fuzz
from tests.fuzz.noisy_wire import Noise

SEED = 1


def _check(table: FuzzTable) -> None:
    assert not table.wrong, "\n".join([str(table), *(f"seed {seed}: {result}" for seed, result in table.wrong)])


@pytest.mark.parametrize("name", DRIVERS)
def test_without_faults_every_motion_arrives(name: str) -> None:
    table = fuzz(DRIVERS[name], 10, SEED, Noise())
    _check(table)
    assert table.answers == {"ok": 10}
