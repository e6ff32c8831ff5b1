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
