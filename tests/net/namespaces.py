"""Network namespaces as machines: a controller, and robots with a link each."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


def why_not() -> str | None:
    """Return why this machine cannot make network namespaces; None if it can."""
    if shutil.which("ip") is None:
        return "ip is not installed; Debian has it in iproute2"
    with ExitStack() as stack:
        try:
            stack.enter_context(_namespace(f"eal{os.getpid()}probe"))
            _ip("link", "add", f"eal{os.getpid()}", "netns", f"eal{os.getpid()}probe", "type", "veth")
        except subprocess.CalledProcessError as error:
            return f"network namespaces are not allowed here: {error.stderr.strip()}"
    return None


@contextmanager
def _namespace(name: str) -> Iterator[str]:
    _ip("netns", "add", name)
    try:
        _ip("-n", name, "link", "set", "lo", "up")
        yield name
    finally:
        _ip("netns", "delete", name)  # and its links


@dataclass(frozen=True)
class Cabled:
    """A controller's machine, and the robots' machines, each at the end of a cable of its own.

    Attributes:
        controller: name of its namespace.
        robots: by robot, the name of its namespace.
        hosts: by robot, its address.
    """

    controller: str
    robots: dict[str, str]
    hosts: dict[str, str]

    def at_controller(self) -> Sequence[str]:
        """Return the prefix of a command line that runs on the controller's machine."""
        return ("ip", "netns", "exec", self.controller)

    def at(self, robot: str) -> Sequence[str]:
        """Return the prefix of a command line that runs on a robot's machine."""
        return ("ip", "netns", "exec", self.robots[robot])

    def cut(self, robot: str) -> None:
        """Disconnect a robot's cable."""
        _ip("-n", self.robots[robot], "link", "set", "cable", "down")


@contextmanager
def cabled(robots: Sequence[str]) -> Iterator[Cabled]:
    """Make the namespaces for the length of a `with` block."""
    stem = f"eal{os.getpid()}"
    with ExitStack() as stack:
        controller = stack.enter_context(_namespace(f"{stem}c"))
        names, hosts = {}, {}
        for number, robot in enumerate(robots, start=1):
            names[robot] = name = stack.enter_context(_namespace(f"{stem}r{number}"))
            hosts[robot] = f"10.77.{number}.2"
            _ip("link", "add", f"cable{number}", "netns", controller, "type", "veth", "peer", "cable", "netns", name)
            for place, cable, address in (
                (controller, f"cable{number}", f"10.77.{number}.1/24"),
                (name, "cable", f"{hosts[robot]}/24"),
            ):
                _ip("-n", place, "address", "add", address, "dev", cable)
                _ip("-n", place, "link", "set", cable, "up")
        yield Cabled(controller, names, hosts)
