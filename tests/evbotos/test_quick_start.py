"""The start of the image's robot: deferred modules load on first use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import evbotos

FOLDER = Path(evbotos.__file__).parent / "rootfs/services/robot/usr/lib/evbotos"
USES = """
import sys
from quick_start import load_when_used
load_when_used("asyncio")
import asyncio
assert "asyncio.events" not in sys.modules
assert asyncio.run(asyncio.sleep(0, "slept")) == "slept"
load_when_used("email")
import email.message
assert email.message.Message and "email.message" in sys.modules
"""


def test_a_module_that_is_loaded_when_it_is_used_is_the_module() -> None:
    done = subprocess.run(
        [sys.executable, "-c", USES], cwd=FOLDER, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr


FAILS = """
import sys
from types import SimpleNamespace
import quick_start

def become_robot():
    raise OSError(5, "Input/output error", "/media/sda/fleet.yaml")

sys.modules["robot_user"] = SimpleNamespace(become_robot=become_robot)
quick_start._CONSOLE = quick_start.Path(sys.argv[1])
quick_start.main()
"""


def test_files_that_cannot_be_read_are_named_on_the_console(tmp_path: Path) -> None:
    words = [sys.executable, "-c", FAILS, str(tmp_path / "console")]
    done = subprocess.run(words, cwd=FOLDER, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    told = (tmp_path / "console").read_text()
    assert told == "evbotos: the robot does not start: [Errno 5] Input/output error: '/media/sda/fleet.yaml'\n"
