"""A process with a session has two heaps, so that what ended threads have freed is used again."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys

import pytest

from eal_actors.kernel.bundled import bundled_path
from tests.net.rig import WAIT_S

THREADS = """
import ctypes, threading
from eal_actors.wire.session import controller_config, open_session
from tests.net.links import fleet_of, free_port

fleet = fleet_of({}, {"r1": f"tcp/127.0.0.1:{free_port()}"})
library = ctypes.CDLL(None)
library.malloc.argtypes, library.malloc.restype = [ctypes.c_size_t], ctypes.c_void_p
all_have = threading.Barrier(9)

def take():
    assert library.malloc(100)
    all_have.wait(30)

with open_session(controller_config(fleet)):
    threads = [threading.Thread(target=take) for _ in range(8)]
    for thread in threads:
        thread.start()
    all_have.wait(30)
    library.malloc_info(0, ctypes.c_void_p.in_dll(library, "stdout"))
"""
"""A controller with eight threads that take memory at the same time."""


def heaps_of(environment: dict[str, str]) -> int:
    run = subprocess.run(
        [sys.executable, "-c", THREADS],
        cwd=bundled_path("."),
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=WAIT_S,
    )
    return run.stdout.count("<heap ")


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_info"), reason="another C library has other heaps")
def test_a_controller_with_many_threads_has_two_heaps_unless_its_user_asked_for_more() -> None:
    assert heaps_of({}) == 2
    assert heaps_of({"MALLOC_ARENA_MAX": "4"}) == 4
