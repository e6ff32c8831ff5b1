"""A refused update never starts, whatever was installed before it and however often the power is cut."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.evbotos.proof import Proof
from tests.evbotos.refusals import prove_refusal

ATTEMPTS = range(30)
SHORT = 2

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.mark.parametrize(
    "seed", [seed if seed < SHORT else pytest.param(seed, marks=pytest.mark.slow) for seed in ATTEMPTS]
)
def test_a_refused_update_never_starts(proof: Proof, disk: Path, tmp_path: Path, seed: int) -> None:
    prove_refusal(proof, disk, tmp_path, seed)
