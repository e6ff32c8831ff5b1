"""Everything in the corpus, and mutations of it, the same in every run; `make fuzz` looks for more."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.corpus import CORPUS, TARGETS, kept, mutated, seeds
from tests.fuzz.loaders import LOADERS


def test_the_corpus_has_seeds_for_every_target_and_no_others() -> None:
    assert {folder.name for folder in CORPUS.iterdir()} == set(TARGETS)
    assert all(seeds(target) for target in TARGETS)


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_kept_is_refused_or_understood(target: str) -> None:
    for path in kept(target):
        TARGETS[target](path.read_bytes())
    for data in (b"", b"\x00", b"\xff" * 4096):
        TARGETS[target](data)


def _settings(target: str) -> Callable[[Callable[[], None]], Callable[[], None]]:
    count = 40 if target in LOADERS else 150
    return settings(max_examples=count, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("target", TARGETS)
def test_mutations_are_refused_or_understood(target: str) -> None:
    known = st.sampled_from(seeds(target))

    @_settings(target)
    @given(known, known, st.randoms(use_true_random=False))
    def fuzz(begin: bytes, other: bytes, chance: Random) -> None:
        TARGETS[target](mutated(begin, other, chance))

    fuzz()
