"""Imports and the simulated demo hold on a system without the modules of POSIX, such as Windows."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.kernel.bundled import bundled_path

HIDE = """
import builtins, os, pkgutil, select, signal, socket, sys
from importlib import import_module
HIDDEN = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}
OURS = ("eal_actors", "plugins", "scenarios")
real = builtins.__import__

def is_ours():
    frame = sys._getframe(2)
    while frame is not None and frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    name = frame.f_globals.get("__name__", "") if frame is not None else ""
    file = frame.f_code.co_filename if frame is not None else ""
    return name.split(".")[0] in OURS or "/plugins/" in file

def hidden_import(name, *rest):
    if name in HIDDEN and is_ours():
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return real(name, *rest)

import importlib
real_module = importlib.import_module

def hidden_import_module(name, package=None):
    if name in HIDDEN:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return real_module(name, package)

builtins.__import__, importlib.import_module = hidden_import, hidden_import_module
for owner, name in ((signal, "SIGHUP"), (os, "getuid"), (os, "memfd_create"), (select, "poll")):
    delattr(owner, name)
"""
"""Hides modules from this project's files, and functions from all. Packages of others have their own ways elsewhere."""
IMPORT_ALL = """
import eal_actors
names = [info.name for info in pkgutil.walk_packages(eal_actors.__path__, "eal_actors.") if "__main__" not in info.name]
for name in names:
    import_module(name)
print(len(names))
"""
DEMO = """
sys.argv = ["eal", "run", "dance", "--fleet", "sim", "--rate", "max", "--no-plot"]
from eal_actors.__main__ import main
main()
"""


def run(program: str, folder: Path) -> str:
    command = [sys.executable, "-c", HIDE + program]
    environment = {**os.environ, "PYTHONPATH": str(bundled_path("."))}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_every_module_imports(tmp_path: Path) -> None:
    assert int(run(IMPORT_ALL, tmp_path)) > 300


@pytest.mark.slow
def test_the_simulated_dance_runs(tmp_path: Path) -> None:
    assert "dance on sim: done" in run(DEMO, tmp_path)


def test_a_simulated_robot_moves(tmp_path: Path) -> None:
    program = """
from eal_actors import connect
with connect("roomba-1", fleet="sim") as eal:
    print(eal.send_cmd(eal.find_resource("Base"), "r45"))
"""
    assert run(program, tmp_path).strip() == "1"
