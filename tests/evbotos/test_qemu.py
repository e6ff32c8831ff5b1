from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.kernel.clock import REAL_TIME
from evbotos.hosttools import find_tool

PROGRAM = """
import sys
from pathlib import Path
from evbotos.definitions import load_definitions
from evbotos.qemu import running
folder = Path(sys.argv[1])
with running(load_definitions().platform("qemu-amd64"), folder, folder / "disk.img", folder / "console") as machine:
    print(machine.ask("query-status")["status"], machine._process.pid, flush=True)
    sys.stdin.read()
"""

pytestmark = pytest.mark.skipif(
    any(find_tool(name) is None for name in ("qemu-system-x86_64", "setpriv")), reason="make evbotos-setup"
)


def test_qemu_does_not_outlive_a_program_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "disk.img").write_bytes(bytes(1 << 20))
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        status, pid = program.stdout.readline().split()
        assert status == "running"
        process = Path("/proc") / pid
        assert "qemu-system" in (process / "cmdline").read_text()
        program.kill()
        program.wait(10)
    end_s = REAL_TIME.now() + 10.0
    while is_alive(process):
        assert REAL_TIME.now() < end_s, "QEMU goes on"
        REAL_TIME.sleep(0.02)


def is_alive(process: Path) -> bool:
    try:
        return " Z " not in (process / "stat").read_text()
    except OSError:
        return False
