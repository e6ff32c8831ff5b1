"""`make demo-network`: serve each robot of a fleet from its own process on this machine, and run a scenario."""

from __future__ import annotations

import json
import os
import re
import secrets
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final

import typer

from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.output import print_line, stderr
from eal_actors.cli.readiness import ready_line
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.missing_modules import require_modules
from eal_actors.managers.network_model import IDENTITY_VARIABLE

_STOP_S: Final = 5.0  # real seconds after which a server that has not ended is killed
_LOOPBACK: Final = "127.0.0.1"
_LOCAL: Final = re.compile(r"(?P<start>(tcp|tls)/(127\.0\.0\.1|localhost):)(?P<port>\d+)")
_PROGRAM: Final = (sys.executable, "-P", "-m", "eal_actors")


def demo_network(
    scenario: Annotated[Path, typer.Argument()] = Path("dance"),
    fleet: Annotated[Path, typer.Option("--fleet", "-f")] = Path("loopback"),
    runs_dir: Annotated[Path, typer.Option()] = Path("runs"),
) -> None:
    """Serve each robot of a fleet from its own process, run a scenario over the network, and stop the servers.

    A robot whose port on this machine is in use gets a free one.
    """
    os.environ[IDENTITY_VARIABLE] = secrets.token_hex(4)  # no robots of another fleet, which may run here as well
    config = read_fleet(fleet)
    local = replace(config, robots={name: replace(robot, address=None) for name, robot in config.robots.items()})
    require_modules(local, local.robots)
    served = [name for name, robot in config.robots.items() if robot.address is not None]
    with _on_free_ports(config) as file, _serving(file, served):
        run = ("run", scenario, "--fleet", file, "--runs-dir", runs_dir, "--show")
        code = subprocess.run([*_PROGRAM, *map(str, run)], check=False).returncode  # noqa: S603  # our own program
    raise typer.Exit(code)


@contextmanager
def _on_free_ports(config: FleetConfig) -> Iterator[Path]:
    """Yield the fleet file; where ports are in use, a temporary one that includes it and has free ones."""
    moved = {}
    for name, robot in config.robots.items():
        local = _LOCAL.fullmatch(str(robot.address))
        if local is not None and (port := _free_port(int(local["port"]))) != int(local["port"]):
            moved[name] = {"address": f"{local['start']}{port}"}
            print_line(stderr(), f"{name}: port {local['port']} is in use by another program", "dim")
    if not moved:
        yield config.source
        return
    with TemporaryDirectory() as folder:
        file = Path(folder) / config.source.name
        content = {"version": 1, "name": config.name, "include": [str(config.source.resolve())], "robots": moved}
        file.write_text(json.dumps(content), encoding="utf-8")
        yield file


def _free_port(wanted: int) -> int:
    """Return this port of the machine; another one if it is in use."""
    try:
        with socket.create_server((_LOOPBACK, wanted)):
            return wanted
    except OSError:
        with socket.create_server((_LOOPBACK, 0)) as trial:
            return int(trial.getsockname()[1])


@contextmanager
def _serving(fleet: Path, robots: Sequence[str]) -> Iterator[None]:
    """Start a server for each robot, wait until all of them listen, and stop them at the end."""
    with ExitStack() as stack:
        servers = [(robot, stack.enter_context(_server(fleet, robot))) for robot in robots]
        for robot, server in servers:
            print_line(stderr(), f"{robot}: {ready_line(server, 'server', robot, 'listening')}", "dim")
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
