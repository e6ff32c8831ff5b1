from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from tests.scenarios.rig import rigs


@pytest.fixture
def two(tmp_path: Path) -> Iterator[Fleet]:
    with rigs(tmp_path, fast={"slowness": 0.1, "tags": ["quick"]}, slow={"tags": ["heavy"]}) as fleet:
        yield fleet
