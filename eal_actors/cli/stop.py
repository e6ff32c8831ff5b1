"""`eal stop` and `eal resume`: the emergency stop of served robots, independent of their leases."""

from __future__ import annotations

from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.options import FleetOption, JsonOption, RobotsArgument
from eal_actors.cli.output import print_line, stdout, write_json
from eal_actors.kernel.errors import EALError, UnavailableError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.format import keys
from eal_actors.wire.rpc.client.broadcast import ask_robots

_LOCAL: Final = "runs in its controller's process: only that process can {} it"
_VERBS: Final = {keys.STOP: "stop", keys.RESUME: "resume"}


def stop_robots(
    fleet: FleetOption,
    robots: RobotsArgument = None,
    reason: Annotated[str, typer.Option(help="Reason, shown to controllers whose commands are refused.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Stop robots at once: everything halts, and no motion starts until `eal resume`.

    Each robot gets the stop as soon as it can be reached, and is shown when it confirms. Unreachable robots are given
    up after 3 s, and the last line names them. The exit code is 1 if a robot did not confirm.
    """
    _send_to_all(read_fleet(fleet, robots or ()), keys.STOP, (reason,), "stopped", as_json=as_json)


def resume_robots(fleet: FleetOption, robots: RobotsArgument = None, as_json: JsonOption = False) -> None:
    """End the emergency stop of robots: motions are allowed again, and none starts by itself.

    The exit code is 1 if a robot did not confirm.
    """
    _send_to_all(read_fleet(fleet, robots or ()), keys.RESUME, (), "resumed", as_json=as_json)


def _send_to_all(config: FleetConfig, method: str, arguments: tuple[str, ...], done: str, *, as_json: bool) -> None:
    outcomes: dict[str, EALError | None] = {}
    out = stdout()

    def record(robot: str, error: EALError | None) -> None:
        outcomes[robot] = error
        if not as_json:
            result = (done, "green") if error is None else (f"not {done}: {error.message}", "bold red")
            print_line(out, Text.assemble((robot, "cyan"), "  ", result))

    if remote := [name for name, robot in config.robots.items() if robot.address is not None]:
        ask_robots(config, remote, method, arguments, on_result=record)
    for name, robot in config.robots.items():
        if robot.address is None:
            record(name, UnavailableError(_LOCAL.format(_VERBS[method]), robot=name))
    if as_json:
        entries = [
            {"name": name, "confirmed": error is None, "reason": None if error is None else error.message}
            for name, error in ((name, outcomes[name]) for name in config.robots)
        ]
        write_json({"fleet": config.name, "robots": entries})
    else:
        print_line(out, _summary(outcomes, done))
    if any(outcomes.values()):
        raise typer.Exit(ExitCode.FAILED)


def _summary(outcomes: dict[str, EALError | None], done: str) -> Text:
    missing = [name for name, error in outcomes.items() if error is not None]
    count = f"{len(outcomes) - len(missing)} of {len(outcomes)} {done}"
    if not missing:
        return Text(count, style="bold green")
    return Text(f"{count}, {', '.join(missing)} NOT CONFIRMED", style="bold red")
