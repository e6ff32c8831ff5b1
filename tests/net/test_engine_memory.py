"""A process of a fleet with sessions has two heaps, so that what ended threads have freed is used again."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.kernel.bundled import bundled_path
from tests.net.rig import WAIT_S, Rig

PROGRAM = """
import ctypes, sys, threading
from eal_actors import Fleet
from eal_actors.facade.service import serve_together
from eal_actors.managers.config import EALConfigManager

what, file = sys.argv[1:]
config = EALConfigManager.load(file).fleet
library = ctypes.CDLL(None)
library.malloc.argtypes, library.malloc.restype = [ctypes.c_size_t], ctypes.c_void_p
all_have = threading.Barrier(9)

def take():
    assert library.malloc(100)
    all_have.wait(30)

with Fleet(config) if what == "controller" else serve_together(config, list(config.robots)):
    threads = [threading.Thread(target=take) for _ in range(8)]
    for thread in threads:
        thread.start()
    all_have.wait(30)
    library.malloc_info(0, ctypes.c_void_p.in_dll(library, "stdout"))
"""
"""Prints the heaps of a process of a fleet when eight more threads have taken memory."""


def heaps_of(program: str, rig: Rig, **environment: str) -> int:
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, program, rig.file],
        env={**os.environ, "PYTHONPATH": str(bundled_path(".")), **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=2 * WAIT_S,
    )
    return run.stdout.count("<heap ")


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_info"), reason="another C library has other heaps")
@pytest.mark.parametrize("program", ["controller", "robots"])
def test_a_fleet_with_sessions_has_two_heaps_unless_its_user_asked_for_more(program: str, tmp_path: Path) -> None:
    rig = Rig(tmp_path, ["r1", "r2", "r3", "r4"])
    assert heaps_of(program, rig) == 2
    assert heaps_of(program, rig, MALLOC_ARENA_MAX="4") == 4
