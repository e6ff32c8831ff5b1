"""A child of `os.fork` whose parent has other threads: the locks that they hold are released by nobody in the child."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.plugin_files import write_plugin

LAMP = """\
import sys
from eal_actors.plugin import EALPlugin, Resource
class Lamp(Resource): pass
if "import" in sys.argv: sys.modules["__main__"].wait_inside()
def connect():
    if "connect" in sys.argv: sys.modules["__main__"].wait_inside()
    return EALPlugin("Lamp")
"""
PROGRAM = """\
import io, os, signal, sys, threading
from eal_actors import Fleet, connect
from eal_actors.kernel.log import configure_logging, get_logger
is_inside, may_leave = threading.Event(), threading.Event()
def wait_inside():
    is_inside.set()
    may_leave.wait()
class Stream(io.StringIO):
    def write(self, text):
        if threading.current_thread() is thread:
            wait_inside()
        return super().write(text)
configure_logging(stream=Stream())
def work():
    if "log" in sys.argv:
        get_logger().warning("a line")
    else:
        with connect("r", fleet="first.yaml") if "connect" in sys.argv else Fleet.load("first.yaml"):
            pass
thread = threading.Thread(target=work)
thread.start()
is_inside.wait()
if not (child := os.fork()):
    signal.alarm(30)
    get_logger().warning("a line of the child")
    with connect("r", fleet="second.yaml"):
        pass
    os._exit(0)
_, status = os.waitpid(child, 0)
may_leave.set()
thread.join()
sys.exit(os.waitstatus_to_exitcode(status))
"""

LOGGING = """\
import os, signal, sys, threading
from eal_actors.kernel.log import get_logger
def work():
    while True:
        get_logger().warning("a line")
threading.Thread(target=work, daemon=True).start()
sys.setswitchinterval(1e-6)
for _ in range(60):
    if not (child := os.fork()):
        signal.alarm(30)
        get_logger().warning("a line of the child")
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        os._exit(1)
os._exit(0)
"""


BUILDING = """\
import os, signal, threading
from typing import Annotated
from eal_actors.kernel.strict_model import DeferredType, StrictModel
is_inside, has_forked = threading.Event(), threading.Event()
def find():
    is_inside.set()
    has_forked.wait(0.5)  # the fork waits for the end of this
    return int
class First(StrictModel):
    number: Annotated[int, DeferredType(find)]
class Second(StrictModel):
    number: int
threading.Thread(target=lambda: First(number=1)).start()
is_inside.wait()
if not (child := os.fork()):
    signal.alarm(30)
    Second(number=1)
    os._exit(0)
has_forked.set()
os._exit(os.waitpid(child, 0)[1] != 0)
"""


QUIET = ("-W", "ignore::DeprecationWarning")
"""Options of Python: 3.12 and later warn of forks."""


@pytest.mark.parametrize("what", ["connect", "import", "log"])
def test_a_child_connects_while_another_thread_of_its_parent_is_at_it(tmp_path: Path, what: str) -> None:
    """It hung for ever."""
    write_plugin(tmp_path, "lamp", LAMP, "Lamp")
    for name, plugin in (("first", "lamp"), ("second", "sample")):
        fleet = {"version": 1, "name": name, "plugin_dirs": ["plugins"], "robots": {"r": {"plugins": {plugin: {}}}}}
        (tmp_path / f"{name}.yaml").write_text(json.dumps(fleet), encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, *QUIET, "-c", PROGRAM, what],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_child_reads_files_while_another_thread_of_its_parent_builds_the_model_of_one() -> None:
    """It hung for ever: the thread had a lock of pydantic."""
    assert subprocess.run([sys.executable, *QUIET, "-c", BUILDING], timeout=60, check=False).returncode == 0


def test_children_log_while_another_thread_of_their_parent_logs(tmp_path: Path) -> None:
    """One in six hung for ever."""
    with (tmp_path / "lines.txt").open("w", encoding="utf-8") as lines:
        ended = subprocess.run([sys.executable, *QUIET, "-c", LOGGING], stderr=lines, timeout=60, check=False)
    assert ended.returncode == 0
    assert (tmp_path / "lines.txt").read_text(encoding="utf-8").count("a line of the child") == 60


SAME = """\
import os, signal, sys
from eal_actors import connect
parent = connect(fleet=sys.argv[1])
if not (child := os.fork()):
    signal.alarm(30)
    with connect(fleet=sys.argv[1]) as lamp:
        value = lamp.get_value(lamp.find_resource("SampleResource")).value
    os._exit(value)
_, status = os.waitpid(child, 0)
parent.disconnect()
sys.exit(os.waitstatus_to_exitcode(status))
"""


def test_a_child_connects_to_its_own_fleet_of_the_file_that_its_parent_has_open(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text("version: 1\nrobots: {r: {plugins: {sample: {}}}}\n", encoding="utf-8")
    program = [sys.executable, *QUIET, "-c", SAME, str(file)]
    ended = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
