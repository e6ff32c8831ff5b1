"""A robot that runs out of file descriptors says so in its answers to pings."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.net.rig import Rig


@contextmanager
def few_descriptors() -> Iterator[None]:
    """Limit this process to a few descriptors more than it uses."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = sum(1 for _ in Path("/proc/self/fd").iterdir())
    resource.setrlimit(resource.RLIMIT_NOFILE, (used + used // 8, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_robot_warns_while_few_descriptors_are_free(tmp_path: Path) -> None:
    with Rig(tmp_path).served_here() as fleet:
        assert fleet["r1"].ping().get().warnings == ()
        with few_descriptors():
            (warning,) = fleet["r1"].ping().get().warnings
        assert "file descriptors are in use; new connections are refused" in warning
        assert fleet["r1"].ping().get().warnings == ()
