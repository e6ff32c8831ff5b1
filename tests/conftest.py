"""What every test gets: no thread may outlive it."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pykka
import pytest
from hypothesis import settings

# How fast a busy machine is says nothing of the code, and what failed must fail again: the same examples in every run.
settings.register_profile("patient", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None)  # `pytest --hypothesis-profile search` looks for new ones
settings.load_profile("patient")


@pytest.fixture(autouse=True)
def no_leaked_threads() -> Iterator[None]:
    """Fail a test that leaves threads or actors behind, naming them."""
    before = set(threading.enumerate())
    yield
    left = [thread for thread in threading.enumerate() if thread not in before]
    for thread in left:
        thread.join(2.0)
    alive = [thread.name for thread in left if thread.is_alive()]
    actors = [str(ref) for ref in pykka.ActorRegistry.get_all()]
    pykka.ActorRegistry.stop_all(block=False)
    assert not alive, f"threads left behind: {alive}"
    assert not actors, f"actors left behind: {actors}"
