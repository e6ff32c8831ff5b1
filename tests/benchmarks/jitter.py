"""How late a robot's loop of 50 Hz wakes, by the preemption of the kernel: writes the table of docs/evbotos.md.

Run as `python -m tests.benchmarks.jitter BUILD [--seconds S] [--page PAGE]`. BUILD is a folder of the image `robot` for
`qemu-amd64`. Its kernel runs with each of its preemption models; Debian's real-time kernel runs the same root.

QEMU counts instructions, each of which takes 2 ns, and an idle machine does not wait. So the load of the computer
that runs QEMU does not change a figure. The program is the machine's first and only one.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from evbotos.bench import SCRIPTS
from evbotos.hosttools import tool
from tests.benchmarks.page import publish
from tests.evbotos.guest import debian_kernel

BEGIN: Final = "<!-- written by python -m tests.benchmarks.jitter: begin -->"
PROGRAM: Final = SCRIPTS / "jitter_loop.py"
MODELS: Final = ("none", "voluntary", "full")
REAL_TIME_KERNEL: Final = "linux-image-rt-amd64"
FIGURES: Final = ("99 %", "worst")
STATES: Final = ("rest", "load", "load and reading")
_MODULES: Final = ("virtio_pci", "virtio_blk", "squashfs")
_INIT: Final = """#!/bin/busybox sh
for module in /modules/*; do /bin/busybox insmod "$module"; done
/bin/busybox mount -t devtmpfs dev /dev
/bin/busybox mount -t squashfs -o ro /dev/vda /root
/bin/busybox mount -o move /dev /root/dev
exec /bin/busybox switch_root /root {program} </root/dev/console >/root/dev/console 2>&1
"""
_SECTOR: Final = 512
_TIMEOUT_S: Final = 3600.0


def program_of(seconds: float) -> list[str]:
    """Return the command in the machine; its second disk is the program."""
    return ["/usr/bin/python3", "/dev/vdb", f"{seconds:g}"]


def boot(root: Path, script: Path, kernel: list[str | Path], line: str) -> list[dict[str, Any]]:
    """Return what the program measures under a kernel.

    Raises:
        RuntimeError: it did not come to its end.
    """
    machine = ["-machine", "q35", "-cpu", "qemu64", "-m", "128", "-accel", "tcg", "-icount", "shift=1,sleep=off"]
    machine += ["-nodefaults", "-no-user-config", "-display", "none", "-no-reboot", "-serial", "stdio"]
    for file in (root, script):
        machine += ["-drive", f"file={file},format=raw,if=virtio,readonly=on"]
    words = f"console=ttyS0 quiet panic=-1 no_timer_check {line}"
    argv = [tool("qemu-system-x86_64"), *machine, *map(str, kernel), "-append", words]
    said = subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_TIMEOUT_S).stdout
    found = [json.loads(text) for text in said.splitlines() if text.startswith('{"')]
    if len(found) != 2 * len(STATES):
        raise RuntimeError(f"the program did not end: {said[-2000:]}")
    return found


def measure(build: Path, seconds: float) -> dict[str, list[dict[str, Any]]]:
    """Return the measurements by kernel."""
    root, program = build / "root.squashfs", program_of(seconds)
    found = {}
    with TemporaryDirectory(prefix="jitter-") as name:
        folder = Path(name)
        script, init = folder / "script", folder / "init"
        text = PROGRAM.read_bytes()
        script.write_bytes(text + b"\n" * (-len(text) % _SECTOR))
        line = f"root=/dev/vda rootfstype=squashfs ro init={program[0]}"
        for model in MODELS:
            words = f"{line} preempt={model} -- {' '.join(program[1:])}"
            found[f"ours, `preempt={model}`"] = boot(root, script, ["-kernel", build / "kernel"], words)
        init.write_text(_INIT.format(program=" ".join(program)))
        kernel, initrd = debian_kernel(folder, REAL_TIME_KERNEL, _MODULES, init)
        arguments: list[str | Path] = ["-kernel", kernel, "-initrd", initrd]
        found["Debian's, `PREEMPT_RT`"] = boot(root, script, arguments, "")
    return found


def table_of(found: dict[str, list[dict[str, Any]]]) -> str:
    """Return the table in Markdown: a row a kernel and priority."""
    heads = ["kernel", "priority", *(f"{state}, {figure}" for state in STATES for figure in FIGURES)]
    lines = [heads, ["---"] * len(heads)]
    for kernel, results in found.items():
        by = {(one["priority"], one["state"]): one for one in results}
        for priority in ("ordinary", "real-time"):
            cells = [f"{by[priority, state][figure]:.0f}" for state in STATES for figure in FIGURES]
            lines.append([kernel, priority, *cells])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main(arguments: list[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.jitter", description=__doc__)
    parser.add_argument("build", type=Path, help="the folder of a build")
    parser.add_argument("--seconds", type=float, default=30, help="of each measurement, in the machine's time")
    parser.add_argument("--page", type=Path, help="the page to write the table into")
    options = parser.parse_args(arguments)
    found = measure(options.build, options.seconds)
    loops = next(iter(found.values()))[0]["loops"]
    publish(f"{table_of(found)}\n\n{loops} loops each; microseconds.", options.page, BEGIN)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
