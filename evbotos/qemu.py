"""Images in QEMU: without KVM, privileges or network access other than forwarded ports."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, Final

from eal_actors.kernel.clock import REAL_TIME
from evbotos.disk import DISK_ID, kernel_line
from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.model import Emulator, EmulatorLoader, Platform
from evbotos.shell import run

PORTS: Final = {"ssh": 22, "eal": 50000}
"""The forwarded ports of the image."""
LOADER: Final = "loader"
"""The file in the output folder that QEMU starts instead of a board's ROM."""
DEVICE_TREE: Final = "emulator.dtb"
"""The file in the output folder with the device tree of QEMU's machine."""
_ANSWER_S: Final = 20.0
_END_S: Final = 10.0
_CODE_CACHE_MB: Final = 128
"""The size of QEMU's translation cache; QEMU's default takes a gigabyte."""


class Machine:
    """A running QEMU.

    Attributes:
        ports: the ports on 127.0.0.1 by service.
        console: the file with the output of the serial console.
    """

    def __init__(self, process: subprocess.Popen[bytes], control: socket.socket, console: Path) -> None:
        self._process = process
        self._control = control
        self._answers: IO[bytes] = control.makefile("rb")
        self.console = console
        try:
            self._answers.readline()  # its greeting
            self.ask("qmp_capabilities")
            self.ports = forwarded(self.monitor("info usernet"))
        except BaseException:
            self._hang_up()
            raise

    def ask(self, command: str, **arguments: object) -> Any:
        """Execute a command of QEMU's machine protocol and return its result.

        Raises:
            BuildError: QEMU has ended or refuses the command.
        """
        try:
            self._control.sendall(json.dumps({"execute": command, "arguments": arguments}).encode() + b"\n")
            while line := self._answers.readline():
                answer = json.loads(line)
                if "error" in answer:
                    raise BuildError(f"qemu: {command}: {answer['error']['desc']}")
                if "return" in answer:
                    return answer["return"]
        except OSError as error:
            raise BuildError(f"qemu does not respond: {error}") from error
        raise BuildError("qemu has ended")

    def monitor(self, line: str) -> str:
        """Execute a line of QEMU's human monitor and return its output."""
        return str(self.ask("human-monitor-command", **{"command-line": line}))

    def computed_s(self) -> float:
        """Return QEMU's processor time in seconds: the cost of a boot, independent of other load."""
        words = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def is_running(self) -> bool:
        """Return whether QEMU is running."""
        return self._process.poll() is None

    def wait(self, timeout_s: float | None = None) -> int:
        """Wait for QEMU's exit code. Thread: blocks the caller."""
        return self._process.wait(timeout_s)

    def kill(self) -> None:
        """Kill QEMU, like a power cut."""
        self._process.kill()
        self._process.wait(_END_S)

    def close(self) -> None:
        """End QEMU and release its resources."""
        if self.is_running():
            self.kill()
        self._hang_up()

    def _hang_up(self) -> None:
        self._answers.close()
        self._control.close()


def forwarded(said: str) -> dict[str, int]:
    """Return the forwarded ports from the output of `info usernet`."""
    inside = {port: name for name, port in PORTS.items()}
    found = re.findall(r"TCP\[HOST_FORWARD\]\s+\d+\s+\S+\s+(\d+)\s+\S+\s+(\d+)", said)
    return {inside[int(guest)]: int(host) for host, guest in found if int(guest) in inside}


def arguments_for(
    platform: Platform,
    disk: Path,
    folder: Path,
    memory_mb: int,
    control: Path,
    console: Path,
    network: str | None = None,
    boot_drive: Path | None = None,
) -> list[str]:
    """Return QEMU's arguments.

    Args:
        platform: a platform with an emulator.
        disk: the disk image.
        folder: the output folder of the build.
        memory_mb: RAM.
        control: the socket of the machine protocol.
        console: the file for the output of the serial console.
        network: a `-netdev` argument that replaces the forwarded ports.
        boot_drive: a small boot drive in addition to the disk.
    """
    emulator = platform.emulator
    assert emulator is not None  # noqa: S101  # ensured by the callers
    forwards = ",".join(f"hostfwd=tcp:127.0.0.1:0-:{port}" for port in PORTS.values())
    arguments = ["-machine", emulator.machine, "-accel", f"tcg,tb-size={_CODE_CACHE_MB}", "-m", str(memory_mb)]
    arguments += ["-smp", str(emulator.cpus), "-nodefaults", "-no-user-config", "-display", "none"]
    arguments += [*["-serial", "null"] * emulator.serial, "-serial", f"file:{console}"]
    arguments += ["-qmp", f"unix:{control},server=on,wait=on"]
    arguments += ["-netdev", f"{network or f'user,restrict=on,{forwards}'},id=net"]
    if emulator.cpu is not None:
        arguments += ["-cpu", emulator.cpu]
    if boot_drive is not None:
        arguments += _drive(emulator, boot_drive, "boot")
    arguments += [*_drive(emulator, disk, "disk"), *_network_card(emulator)]
    if emulator.watchdog is not None:
        arguments += ["-device", emulator.watchdog, "-action", "watchdog=reset"]
    if emulator.has_pci:
        arguments += ["-device", "virtio-rng-pci", "-device", "qemu-xhci,id=usb"]
    if platform.loader == "none":
        arguments += _direct_boot(platform, folder)
    elif emulator.loader is not None:
        places = {"loader": folder / LOADER, "device_tree": folder / DEVICE_TREE}
        arguments += [word.format(**places) for word in emulator.loader.arguments]
    return [tool(emulator.program), *arguments]


def _drive(emulator: Emulator, file: Path, name: str) -> list[str]:
    drive = f"file={file},format=raw,id={name},cache=unsafe"
    if emulator.disk == "sd":
        return ["-drive", f"{drive},if=sd"]
    serial = f",serial={name}" if emulator.disk == "nvme" else ""  # which it requires
    return ["-drive", f"{drive},if=none", "-device", f"{emulator.disk},drive={name}{serial}"]


def _network_card(emulator: Emulator) -> list[str]:
    if emulator.network_on_board:
        return ["-net", f"nic,netdev=net,model={emulator.network}"]
    return ["-device", f"{emulator.network},netdev=net"]


def _direct_boot(platform: Platform, folder: Path) -> list[str]:
    emulator, initial = platform.emulator, folder / "initrd"
    assert emulator is not None  # noqa: S101  # as above
    words = f"root=PARTUUID={DISK_ID}-02 {kernel_line(platform)}"
    more = ["-initrd", str(initial)] if initial.is_file() else []
    if emulator.device_tree is not None:
        more += ["-dtb", str(folder / DEVICE_TREE)]
    return ["-kernel", str(folder / "kernel"), *more, "-append", words]


def loader_of(file: bytes, loader: EmulatorLoader) -> bytes:
    """Return the boot loader in the form that QEMU starts.

    Raises:
        BuildError: a word to overwrite is missing.
    """
    content = file[loader.skip :]
    for words in loader.blank:
        if words.encode() not in content:
            raise BuildError(f"{loader.file} does not say {words!r}")
        content = content.replace(words.encode(), b" " * len(words))
    return content


def write_device_tree(tree: Path, lacks: Iterable[str], out: Path) -> None:
    """Write the device tree of QEMU's machine.

    Args:
        tree: the device tree of the board.
        lacks: nodes that QEMU's machine does not have.
        out: the file.

    Raises:
        BuildError: the tree or a node is missing.
    """
    if not tree.is_file():
        raise BuildError(f"QEMU's machine needs {tree.name}: name it under the kernel's `device_trees`")
    shutil.copyfile(tree, out)
    for node in lacks:
        run([tool("fdtput"), "-t", "s", out, node, "status", "disabled"])


@contextmanager
def running(
    platform: Platform,
    folder: Path,
    disk: Path,
    console: Path,
    memory_mb: int | None = None,
    network: str | None = None,
    boot_drive: Path | None = None,
) -> Iterator[Machine]:
    """Run an image during a `with` block.

    Args:
        platform: a platform with an emulator.
        folder: the output folder of the build.
        disk: the disk image, which is modified.
        console: the file for the output of the serial console.
        memory_mb: RAM; None selects the platform's default.
        network: a `-netdev` argument that replaces the forwarded ports.
        boot_drive: a small boot drive in addition to the disk; it is modified too.

    Raises:
        BuildError: QEMU does not start.
    """
    if platform.emulator is None:
        raise BuildError(f"QEMU cannot emulate {platform.name}")
    with TemporaryDirectory(prefix="evbotos-") as work, _as_card(disk, platform.emulator):
        control = Path(work) / "qmp"
        memory_mb = memory_mb or platform.emulator.memory_mb
        said = Path(work) / "said"
        with said.open("wb") as errors:
            argv = arguments_for(platform, disk, folder, memory_mb, control, console, network, boot_drive)
            argv = [tool("setpriv"), "--pdeathsig", "KILL", *argv]  # it must not outlive a killed program
            process = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors)  # noqa: S603
        try:
            machine = _machine(process, control, console, said)
        except BaseException:
            process.kill()
            process.wait(_END_S)
            raise
        try:
            yield machine
        finally:
            machine.close()


@contextmanager
def _as_card(disk: Path, emulator: Emulator) -> Iterator[None]:
    """Let the size of a disk be a power of two in a `with` block, if it is a card: QEMU takes no others."""
    size = disk.stat().st_size
    if emulator.disk == "sd":
        os.truncate(disk, 1 << (size - 1).bit_length())
    try:
        yield
    finally:
        os.truncate(disk, size)


def _machine(process: subprocess.Popen[bytes], control: Path, console: Path, said: Path) -> Machine:
    end = _connect(process, control, said)
    try:
        return Machine(process, end, console)
    except (BuildError, OSError) as error:
        raise BuildError(f"qemu does not start: {said.read_text(errors='replace').strip() or error}") from error


def _connect(process: subprocess.Popen[bytes], path: Path, said: Path) -> socket.socket:
    """Return a connection to QEMU, which waits for it before starting the machine."""
    end_s = REAL_TIME.now() + _ANSWER_S
    control = socket.socket(socket.AF_UNIX)
    control.settimeout(_ANSWER_S)
    while REAL_TIME.now() < end_s and process.poll() is None:
        with suppress(FileNotFoundError, ConnectionRefusedError):
            control.connect(str(path))
            return control
        REAL_TIME.sleep(0.02)
    control.close()
    raise BuildError(f"qemu does not start: {said.read_text(errors='replace').strip() or 'no output'}")
