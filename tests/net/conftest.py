"""Fixtures of the network's tests: one robot served in this process, reached through a real link."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import RobotHandle
from tests.net.rig import Rig


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


@pytest.fixture
def fleet(rig: Rig) -> Iterator[Fleet]:
    """The fleet of the rig, through the network."""
    with rig.served_here() as fleet:
        yield fleet


@pytest.fixture
def remote(fleet: Fleet) -> RobotHandle:
    """The only robot of that fleet."""
    return fleet["r1"]
