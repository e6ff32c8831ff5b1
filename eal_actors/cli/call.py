"""`eal call`: call one of the nine methods of a resource, or halt it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated, Any, Final

import typer

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.cli.completion import complete_resources, complete_robots
from eal_actors.cli.exit_codes import SEE_BLOCKING
from eal_actors.cli.fleets import find_resource, plugin_advice, read_fleet
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import format_answer, to_json, write_json
from eal_actors.device.data import EALData
from eal_actors.device.info import unknown_name
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import ConfigError, DeadlineError
from eal_actors.kernel.printable import printable
from eal_actors.kernel.yaml_source import parse_yaml, plain_value
from eal_actors.kernel.yaml_tree import plain

_Call = Callable[[ResourceHandle, list[str], float | None], Future[Any]]


def _parse_value(text: str) -> Any:
    """Return the value of an argument, which is a YAML scalar or a list in brackets; quotes force text."""
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'":
        return text[1:-1]
    try:
        return plain(parse_yaml(f"list: {text}", text).root["list"]) if text.startswith("[") else plain_value(text)
    except (ConfigError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None


def _parse_length(text: str) -> int:
    number = _parse_value(text)
    if isinstance(number, bool) or not isinstance(number, int) or number < 0:
        raise typer.BadParameter(f"read_comm needs a number of bytes, not {text!r}")
    return number


# By method: its arguments as shown to users, the least number of them, and the call.
_METHODS: Final[dict[str, tuple[str, int, _Call]]] = {
    "get_status": ("", 0, lambda r, _, t: r.get_status(timeout_s=t)),
    "get_value": ("", 0, lambda r, _, t: r.get_value(timeout_s=t)),
    "set_value": ("VALUE", 1, lambda r, a, t: r.set_value(_parse_value(a[0]), timeout_s=t)),
    "send_req": ("REQUEST", 1, lambda r, a, t: r.send_req(a[0], timeout_s=t)),
    "send_cmd": ("COMMAND [DATA]", 1, lambda r, a, t: r.send_cmd(a[0], *map(_parse_value, a[1:]), timeout_s=t)),
    "read_comm": ("LENGTH", 1, lambda r, a, t: r.read_comm(_parse_length(a[0]), timeout_s=t)),
    "write_comm": ("TEXT", 1, lambda r, a, t: r.write_comm(a[0], timeout_s=t)),
    "get_config": ("KEY", 1, lambda r, a, t: r.get_config(a[0], timeout_s=t)),
    "set_config": ("KEY VALUE", 2, lambda r, a, t: r.set_config(a[0], _parse_value(a[1]), timeout_s=t)),
    "halt": ("", 0, lambda r, _, t: r.halt(timeout_s=t)),
}

_HALT_S: Final = 0.5  # real seconds within which a resource halts unless its actor is blocked


def call_method(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Name of the robot.", autocompletion=complete_robots)],
    resource: Annotated[
        str, typer.Argument(metavar="RESOURCE", help="Name of the resource.", autocompletion=complete_resources)
    ],
    method: Annotated[str, typer.Argument(metavar="METHOD", help=f"One of {', '.join(_METHODS)}.")],
    fleet: FleetOption,
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ARGUMENT", help="Arguments of the method: numbers, lists such as [1, 0.5], true, false, text."
        ),
    ] = None,
    timeout_s: Annotated[
        float | None, typer.Option(min=0.0, help="Time limit in fleet seconds; default: timeout_s of the fleet file.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Call one method of one resource and print its answer.

    Only this robot is connected. After the answer it is halted and disconnected. Examples:

    eal call roomba-1 Base send_cmd r45 --fleet fleets/sim.yaml

    eal call roomba-1 Base get_config speed_m_s --fleet fleets/sim.yaml

    eal call roomba-1 Base halt --fleet fleets/sim.yaml

    A value set by set_config lasts for this one call. To set a value and then use it, write a scenario.
    """
    call, texts = _check_arguments(method, arguments or [])
    with Fleet(read_fleet(fleet, [robot])) as opened, plugin_advice(opened):
        answer = _get_answer(find_resource(opened, robot, resource), call, texts, timeout_s, opened.clock)
    if as_json:
        called = {"robot": robot, "resource": resource, "method": method, "arguments": texts}
        write_json({**called, **_answer_as_json(answer)})
    else:
        text = format_answer(answer)
        typer.echo(printable(text) if sys.stdout.isatty() else text)


def _get_answer(
    handle: ResourceHandle, call: _Call, texts: list[str], timeout_s: float | None, clock: Clock
) -> EALData | int:
    """Return the call's answer; on a timeout, note on the error if the call blocks its actor."""
    try:
        return call(handle, texts, timeout_s).get()  # type: ignore[no-any-return]
    except DeadlineError as error:
        if handle.halt(timeout_s=clock.of_real(_HALT_S)).exception() is not None:
            error.add_note(SEE_BLOCKING)
        raise


def _check_arguments(method: str, arguments: list[str]) -> tuple[_Call, list[str]]:
    if method not in _METHODS:
        raise typer.BadParameter(unknown_name("method", method, _METHODS))
    for text in arguments:
        if text.startswith("--"):
            raise typer.BadParameter(f"no such option: {text}")
    usage, least, call = _METHODS[method]
    if not least <= len(arguments) <= len(usage.split()):
        raise typer.BadParameter(f"{method} takes {usage or 'no argument'}, not {' '.join(arguments) or 'none'}")
    return call, arguments


def _answer_as_json(answer: EALData | int) -> dict[str, Any]:
    if not isinstance(answer, EALData):
        return {"value": answer}
    return {
        "value": to_json(answer),
        "type": answer.type.value,
        "length": answer.length,
        "shape": None if answer.shape is None else list(answer.shape),
        "unit": answer.unit,
        "frame_id": answer.frame_id,
        "stamp_s": answer.stamp_s,
    }
