"""Machines in folders, each with processes of its own: what their boot loader does, and power cuts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from eal_actors.kernel.clock import REAL_TIME
from evbotos.slots import state_block
from evbotos.verity import Verity
from tests.evbotos.machine_rig import OWN, POWER, choice, comes_true, fill_machine
from tests.evbotos.proof import eal, parse_choice
from tests.net.links import free_port

FORMER = Verity(1, "0d" * 32, "cd" * 16)
"""The identity of the root that each machine has at first."""
_NETWORK = (
    "network:",
    "  lease_s: 30  # the processes of ten machines share a processor",
    "  dead_man_s: 30",
    "  security: {keys: keys, controller: controller, roles: {controllers: [controller]}}",
)
BROKEN = b"this root does not come up"


class FolderMachine:
    """A machine in a folder: `boot` is its loader; a program in its folder is its `reboot`."""

    def __init__(self, folder: Path, robot: str) -> None:
        self.folder, self.robot = folder, robot
        self._process: subprocess.Popen[bytes] | None = None
        reboot = folder / "bin/reboot"
        reboot.parent.mkdir()
        reboot.write_text(f"#!/bin/sh\ntouch {folder}/reboots\n")
        reboot.chmod(0o755)

    def boot(self) -> None:
        """Start the slot to try, or else the good one; one that does not come up is followed by the good one."""
        values = choice(self.folder)
        due = values.get("try", "")
        slot = due if due and self._verity(due) and not self._content(due).startswith(BROKEN) else values["good"]
        values["try"] = ""
        (self.folder / "slots.env").write_bytes(state_block(values))
        for name in ("new-slot", "reboots", POWER, "update.sock", "update.wake", "serve.log"):
            (self.folder / name).unlink(missing_ok=True)
        (self.folder / "slot").write_text(f"{slot}\n")
        (self.folder / "start").write_text(f"{uuid4()}\n")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.evbotos.machine_process", self.folder, self.robot], start_new_session=True
        )

    def lose_power_after(self, count: int) -> None:
        """Let the machine lose its power once so many bytes of an update have been written, until its next start."""
        (self.folder / POWER).write_text(str(count))

    def cut_power(self) -> None:
        """Kill all processes."""
        if self._process is not None:
            with suppress(ProcessLookupError):  # it has lost its power
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None

    def wants_restart(self) -> bool:
        """Return whether `reboot` was called."""
        return (self.folder / "reboots").exists()

    def running_root(self) -> bytes:
        """Return the content of the running slot."""
        return self._content((self.folder / "slot").read_text().strip())

    def is_up(self) -> bool:
        """Return whether the robot serves and its slot is good."""
        return (self.folder / "update.wake").exists()

    def _content(self, slot: str) -> bytes:
        return (self.folder / f"device-{slot}").read_bytes()

    def _verity(self, slot: str) -> str:
        return parse_choice((self.folder / f"root-{slot}.env").read_bytes()).get("verity", "")


@contextmanager
def machines_of(
    folder: Path, names: Sequence[str], plugins: dict[str, str], root: bytes
) -> Iterator[dict[str, FolderMachine]]:
    """Run a secured fleet of machines; what calls `reboot` is started again.

    Args:
        folder: where they are; gets the controller's `fleet.yaml` and keys.
        names: the robots.
        plugins: further plugins of robots, as YAML, by robot.
        root: the content of each machine's first slot.
    """
    lines = ["version: 1", "name: lab", "defaults: {timeout_s: 60}", *_NETWORK, "robots:"]
    for name in names:
        state = folder / name
        lines += [
            f"  {name}:",
            f"    address: tls/127.0.0.1:{free_port()}",
            "    plugins:",
            "      sim: {model: evbot3}",
            f"      evbotos: {{state: {state}, about: {state}}}",
            *([f"      {plugins[name]}"] if name in plugins else []),
        ]
    fleet = folder / "fleet.yaml"
    fleet.write_text("\n".join([*lines, ""]))
    eal("keys", "init", "--fleet", fleet)
    eal("keys", "robot", *names, "--fleet", fleet)
    eal("keys", "controller", "controller", "--fleet", fleet)
    made = {}
    for name in names:
        state = folder / name
        state.mkdir()
        fill_machine(state, len(root) + 3_000_000)
        with (state / "device-a").open("r+b") as device:
            device.write(root)
        (state / "root-a.env").write_bytes(state_block(FORMER.hash_file()))
        (state / "fleet.yaml").symlink_to(fleet)
        (state / "keys").symlink_to(folder / "keys")
        made[name] = FolderMachine(state, name)
    ends = threading.Event()

    def restart() -> None:
        while not ends.is_set():
            for machine in made.values():
                if machine.wants_restart():
                    machine.cut_power()
                    machine.boot()
            REAL_TIME.sleep(0.1)

    loader = threading.Thread(target=restart)
    try:
        for machine in made.values():
            machine.boot()
        assert comes_true(lambda: all(machine.is_up() for machine in made.values())), OWN
        loader.start()
        yield made
    finally:
        ends.set()
        if loader.is_alive():
            loader.join()
        for machine in made.values():
            machine.cut_power()
