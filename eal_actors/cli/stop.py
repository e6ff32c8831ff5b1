"""`eal stop` and `eal resume`: the emergency stop of robots that are served, whoever commands them."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.opening import read_fleet
from eal_actors.cli.options import FleetOption, JsonOption, RobotsArgument
from eal_actors.cli.output import stdout, write_json
from eal_actors.kernel.errors import EALError, UnavailableError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.net.controller.broadcast import ask_robots
from eal_actors.net.wire import keys

_LOCAL = "lives in its controller's process, which alone can stop it"


def stop_robots(
    fleet: FleetOption,
    robots: RobotsArgument = None,
    reason: Annotated[str, typer.Option(help="Told to those whose commands are refused from now on.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Stop robots at once: what moves is halted, and no motion begins until `eal resume`.

    Each robot is told as soon as it can be reached, and shown as it confirms; absent ones are given up after 3 s. Ends
    with 1 if a robot did not confirm.
    """
    _tell_all(read_fleet(fleet, robots or ()), keys.STOP, (reason,), "stopped", as_json=as_json)


def resume_robots(fleet: FleetOption, robots: RobotsArgument = None, as_json: JsonOption = False) -> None:
    """End the emergency stop of robots: motions are possible again, and none starts by itself.

    Ends with 1 if a robot did not confirm.
    """
    _tell_all(read_fleet(fleet, robots or ()), keys.RESUME, (), "resumed", as_json=as_json)


def _tell_all(config: FleetConfig, method: str, arguments: tuple[str, ...], done: str, *, as_json: bool) -> None:
    outcomes: dict[str, EALError | None] = {}
    out = stdout()

    def tell(robot: str, error: EALError | None) -> None:
        outcomes[robot] = error
        if not as_json:
            what = (done, "green") if error is None else (f"not {done}: {error.message}", "bold red")
            out.print(Text.assemble((robot, "cyan"), "  ", what), soft_wrap=True)

    remote = [name for name, robot in config.robots.items() if robot.address is not None]
    if remote:
        ask_robots(config, remote, method, arguments, on_result=tell)
    for name, robot in config.robots.items():
        if robot.address is None:
            tell(name, UnavailableError(_LOCAL, robot=name))
    if as_json:
        write_json({"fleet": config.name, "robots": [_described(name, outcomes[name]) for name in config.robots]})
    if any(outcomes.values()):
        raise typer.Exit(ExitCode.FAILED)


def _described(robot: str, error: EALError | None) -> dict[str, Any]:
    return {"name": robot, "confirmed": error is None, "reason": None if error is None else error.message}
