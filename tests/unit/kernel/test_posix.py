"""Imports and the simulated demo hold on a system without the modules of POSIX, such as Windows."""

from __future__ import annotations

import getpass
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.posix import user_name

NAMES = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty")
HIDE = (
    f"HIDDEN = {set(NAMES)}"
    """
import builtins, os, pkgutil, select, signal, socket, sys
from importlib import import_module
OURS = ("eal_actors", "plugins", "scenarios")
real = builtins.__import__

def is_ours():
    frame = sys._getframe(2)
    while frame is not None and frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    name = frame.f_globals.get("__name__", "") if frame is not None else ""
    file = frame.f_code.co_filename if frame is not None else ""
    return name.split(".")[0] in OURS or "/plugins/" in file

def hidden_import(name, globals=None, locals=None, fromlist=(), level=0):
    if name in HIDDEN and not level and is_ours():
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return real(name, globals, locals, fromlist, level)

import importlib
real_module = importlib.import_module

def hidden_import_module(name, package=None):
    if name in HIDDEN:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return real_module(name, package)

builtins.__import__, importlib.import_module = hidden_import, hidden_import_module
for owner, name in ((signal, "SIGHUP"), (os, "getuid"), (os, "memfd_create"), (os, "openpty"), (select, "poll")):
    delattr(owner, name)
delattr(socket, "TCP_INFO")
"""
)
"""Hides modules from this project's files, and functions from all. Packages of others have their own ways elsewhere."""
IMPORT_ALL = """
import eal_actors, plugins
folders = (eal_actors, "eal_actors."), (plugins, "plugins.")
names = [info.name for owner, name in folders for info in pkgutil.walk_packages(owner.__path__, name)]
names = [name for name in names if "__main__" not in name]
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


def test_modules_of_posix_are_imported_in_one_place() -> None:
    """A quick form of the tests below: no module imports one when it is itself imported."""
    found = re.compile(rf"^(?:import|from) (?:{'|'.join(NAMES)})\b", re.MULTILINE)
    files = [file for part in ("eal_actors", "plugins") for file in bundled_path(part).rglob("*.py")]
    assert len(files) > 300
    assert [str(file) for file in files if found.search(file.read_text(encoding="utf-8"))] == []


def test_a_user_without_a_name_is_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_211_234)  # as in a container that runs with `--user`
    with pytest.raises((KeyError, OSError)):
        getpass.getuser()
    assert user_name.__wrapped__() == "4211234"


def test_users_are_named_in_one_place() -> None:
    files = [file for part in ("eal_actors", "plugins") for file in bundled_path(part).rglob("*.py")]
    assert [file.name for file in files if "getuser" in file.read_text(encoding="utf-8")] == ["posix.py"]


@pytest.mark.slow
def test_every_module_imports(tmp_path: Path) -> None:
    assert int(run(IMPORT_ALL, tmp_path)) > 300


@pytest.mark.slow
def test_the_simulated_dance_runs(tmp_path: Path) -> None:
    assert "dance on sim: done" in run(DEMO, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "arguments"), [("plugins.evbot2.emulator", []), ("plugins.roomba.emulator", ["--protocol", "oi"])]
)
def test_an_emulator_without_pseudo_terminals_says_so(tmp_path: Path, module: str, arguments: list[str]) -> None:
    program = f"""
import runpy
sys.argv = ["emulator", "--pty", *{arguments}]
try:
    runpy.run_module("{module}", run_name="__main__")
except SystemExit as end:
    print(end.code)
"""
    assert run(program, tmp_path).strip() == "this system has no pseudo-terminals"


SERVED = """
import json, threading
from pathlib import Path
from eal_actors import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.managers.config import EALConfigManager
from eal_actors.wire import link_watch, own_sockets
os.environ["USERNAME"] = "tester"  # which Windows sets
own_sockets.OPEN_FILES = Path("/no/such/folder")  # as where there is no /proc
looked, failed = threading.Semaphore(0), []
real_look = link_watch.LinkWatch.look
def look(watch):
    try:
        real_look(watch)
    finally:
        looked.release()
link_watch.LinkWatch.look = look
threading.excepthook = failed.append
with socket.socket() as probe:
    probe.bind(("127.0.0.1", 0))
    address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
robot = {"plugins": {"sim": {"model": "roomba"}}, "address": address}
Path("fleet.yaml").write_text(json.dumps({"version": 1, "name": "one", "robots": {"r1": robot}}))
with RobotService(EALConfigManager.load(Path("fleet.yaml")).fleet, "r1"), Fleet.load(Path("fleet.yaml")) as fleet:
    print(fleet["r1"]["Base"].send_cmd("r45").get())
    for _ in range(3):
        assert looked.acquire(timeout=60)
    print(fleet["r1"]["Base"].send_cmd("l45").get(), failed)
"""


@pytest.mark.slow
def test_a_served_robot_moves_without_its_links_being_watched(tmp_path: Path) -> None:
    assert run(SERVED, tmp_path).split("\n")[:2] == ["1", "1 []"]


def test_a_simulated_robot_moves(tmp_path: Path) -> None:
    program = """
from eal_actors import connect
with connect("roomba-1", fleet="sim") as eal:
    print(eal.send_cmd(eal.find_resource("Base"), "r45"))
"""
    assert run(program, tmp_path).strip() == "1"
