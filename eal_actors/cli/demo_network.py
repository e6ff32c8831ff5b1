"""`make demo-network`: serve each robot of a fleet from its own process on this machine, and run a scenario."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.output import print_line, stderr
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.network_model import IDENTITY_VARIABLE

_STOP_S: Final = 5.0  # real seconds after which a server that has not ended is killed
_PROGRAM: Final = (sys.executable, "-m", "eal_actors")


def demo_network(
    scenario: Annotated[Path, typer.Argument()] = Path("dance"),
    fleet: Annotated[Path, typer.Option("--fleet", "-f")] = Path("loopback"),
    runs_dir: Annotated[Path, typer.Option()] = Path("runs"),
) -> None:
    """Serve each robot of a fleet from its own process, run a scenario over the network, and stop the servers."""
    os.environ[IDENTITY_VARIABLE] = secrets.token_hex(4)  # no robots of another fleet, which may run here as well
    served = [name for name, robot in read_fleet(fleet).robots.items() if robot.address is not None]
    with _serving(fleet, served):
        run = ("run", scenario, "--fleet", fleet, "--runs-dir", runs_dir, "--show")
        code = subprocess.run([*_PROGRAM, *map(str, run)], check=False).returncode  # noqa: S603  # our own program
    raise typer.Exit(code)


@contextmanager
def _serving(fleet: Path, robots: Sequence[str]) -> Iterator[None]:
    """Start a server for each robot, wait until all of them listen, and stop them at the end."""
    with ExitStack() as stack:
        servers = [(robot, stack.enter_context(_server(fleet, robot))) for robot in robots]
        for robot, server in servers:
            print_line(stderr(), _wait_until_listening(robot, server), "dim")
        yield


@contextmanager
def _server(fleet: Path, robot: str) -> Iterator[subprocess.Popen[str]]:
    command = [*_PROGRAM, "serve", "--fleet", str(fleet), "--robot", robot]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)  # noqa: S603  # our own program
    try:
        yield server
    finally:
        server.terminate()
        try:
            server.communicate(timeout=_STOP_S)
        except subprocess.TimeoutExpired:
            server.kill()
            server.communicate()


def _wait_until_listening(robot: str, server: subprocess.Popen[str]) -> str:
    """Return the line that a server prints when it listens.

    Raises:
        UnavailableError: the server has ended instead; its stderr says why.
    """
    for line in server.stdout or ():
        if line.startswith("listening"):
            return f"{robot}: {line.rstrip()}"
    raise UnavailableError("its server has ended; see its message above", robot=robot)
