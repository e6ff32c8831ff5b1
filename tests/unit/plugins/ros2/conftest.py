"""A router with zenoh-ros2-sdk for the tests of a module; what a test makes there ends with it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.unit.plugins.ros2.rig import Ros2Peer, ros2_peer


@pytest.fixture(scope="module")
def router(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros2Peer]:
    with ros2_peer(tmp_path_factory.mktemp("messages")) as made:
        yield made


@pytest.fixture
def peer(router: Ros2Peer) -> Iterator[Ros2Peer]:
    with router:
        yield router
