from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.kernel.clock import REAL_TIME
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.qemu import DEVICE_TREE, LOADER, running

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

TOOLS = "qemu-system-x86_64", "qemu-system-aarch64", "setpriv", "dtc"
TREE = "/dts-v1/; / { #address-cells = <1>; #size-cells = <1>; };"

pytestmark = pytest.mark.skipif(any(find_tool(name) is None for name in TOOLS), reason="make evbotos-setup")


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


def test_a_card_of_any_size_fits_and_keeps_its_size(tmp_path: Path) -> None:
    """QEMU takes cards of a power of two alone."""
    disk = tmp_path / "disk.img"
    disk.write_bytes(bytes(3 << 20))
    (tmp_path / LOADER).write_bytes(b"loader")
    subprocess.run(["dtc", "-q", "-O", "dtb", "-o", tmp_path / DEVICE_TREE], input=TREE.encode(), check=True)
    board = load_definitions().platform("raspberry-pi")
    with running(board, tmp_path, disk, tmp_path / "console") as machine:
        assert machine.ask("query-status")["status"] == "running"
        assert disk.stat().st_size == 4 << 20
    assert disk.stat().st_size == 3 << 20


def test_what_qemu_says_as_it_ends_is_told(tmp_path: Path) -> None:
    disk = tmp_path / "disk.img"
    disk.write_bytes(bytes(1 << 20))
    board = load_definitions().platform("raspberry-pi")
    with pytest.raises(BuildError, match=r"(?s)qemu does not start: .*could not load kernel"):  # noqa: SIM117
        with running(board, tmp_path, disk, tmp_path / "console"):
            pass


def is_alive(process: Path) -> bool:
    try:
        return " Z " not in (process / "stat").read_text()
    except OSError:
        return False
