"""`eal call`: one call of one of the nine methods, or a halt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Final

import typer

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.cli.exit_codes import SEE_BLOCKING
from eal_actors.cli.opening import advice_on_plugins, find_resource, read_fleet
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import plain, shown_value, write_json
from eal_actors.device.data import EALData
from eal_actors.device.info import unknown_name
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import DeadlineError
from eal_actors.kernel.yaml_source import plain_value

_Call = Callable[[ResourceHandle, list[str], float | None], Future[Any]]


def _value(text: str) -> Any:
    """Return what an argument means: a YAML scalar; quotes make text of anything."""
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'":
        return text[1:-1]
    try:
        return plain_value(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def _length(text: str) -> int:
    number = _value(text)
    if isinstance(number, bool) or not isinstance(number, int) or number < 0:
        raise typer.BadParameter(f"read_comm needs a number of bytes, not {text!r}")
    return number


# Method to its arguments as people write them, how many it needs, and the call.
_METHODS: Final[dict[str, tuple[str, int, _Call]]] = {
    "get_status": ("", 0, lambda r, _, t: r.get_status(timeout_s=t)),
    "get_value": ("", 0, lambda r, _, t: r.get_value(timeout_s=t)),
    "set_value": ("VALUE", 1, lambda r, a, t: r.set_value(_value(a[0]), timeout_s=t)),
    "send_req": ("REQUEST", 1, lambda r, a, t: r.send_req(a[0], timeout_s=t)),
    "send_cmd": ("COMMAND [DATA]", 1, lambda r, a, t: r.send_cmd(a[0], *map(_value, a[1:]), timeout_s=t)),
    "read_comm": ("LENGTH", 1, lambda r, a, t: r.read_comm(_length(a[0]), timeout_s=t)),
    "write_comm": ("TEXT", 1, lambda r, a, t: r.write_comm(a[0], timeout_s=t)),
    "get_config": ("KEY", 1, lambda r, a, t: r.get_config(a[0], timeout_s=t)),
    "set_config": ("KEY VALUE", 2, lambda r, a, t: r.set_config(a[0], _value(a[1]), timeout_s=t)),
    "halt": ("", 0, lambda r, _, t: r.halt(timeout_s=t)),
}

_HALT_S: Final = 0.5
"""How soon (real time) a resource halts whose actor is not blocked."""


def call_method(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="The robot's name.", show_default=False)],
    resource: Annotated[str, typer.Argument(metavar="RESOURCE", help="The resource's name.", show_default=False)],
    method: Annotated[str, typer.Argument(metavar="METHOD", help=f"One of {', '.join(_METHODS)}.", show_default=False)],
    fleet: FleetOption,
    arguments: Annotated[
        list[str] | None,
        typer.Argument(metavar="ARGUMENT", help="The method's arguments: numbers, true, false, text."),
    ] = None,
    timeout_s: Annotated[
        float | None,
        typer.Option(min=0.0, help="Seconds of the fleet's clock to wait; the file's timeout_s if left out."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Call one method of one resource and print what it answers.

    Only that robot is connected. It is halted and disconnected again when the answer is there. Examples:

    eal call roomba-1 Base send_cmd r45 --fleet fleets/sim.yaml

    eal call roomba-1 Base get_config speed_m_s --fleet fleets/sim.yaml

    eal call roomba-1 Base halt --fleet fleets/sim.yaml

    What set_config sets lasts for this one call only; a scenario sets a value and then works with it.
    """
    call, texts = _checked(method, arguments or [])
    with Fleet(read_fleet(fleet, [robot])) as opened, advice_on_plugins(opened):
        answer = _answer(find_resource(opened, robot, resource), call, texts, timeout_s, opened.clock)
    if as_json:
        write_json({"robot": robot, "resource": resource, "method": method, "arguments": texts, **_described(answer)})
    else:
        typer.echo(shown_value(answer))


def _answer(
    handle: ResourceHandle, call: _Call, texts: list[str], timeout_s: float | None, clock: Clock
) -> EALData | int:
    """Return what the call answers; a call that is late is told apart from one that blocks its actor."""
    try:
        answer: EALData | int = call(handle, texts, timeout_s).get()
    except DeadlineError as error:
        if handle.halt(timeout_s=clock.of_real(_HALT_S)).exception() is not None:
            error.add_note(SEE_BLOCKING)
        raise
    return answer


def _checked(method: str, arguments: list[str]) -> tuple[_Call, list[str]]:
    if method not in _METHODS:
        raise typer.BadParameter(unknown_name("method", method, _METHODS))
    for text in arguments:
        if text.startswith("--"):
            raise typer.BadParameter(f"no such option: {text}")
    usage, least, call = _METHODS[method]
    if not least <= len(arguments) <= len(usage.split()):
        raise typer.BadParameter(
            f"{method} takes {usage or 'no argument'}, but was given {' '.join(arguments) or 'none'}"
        )
    return call, arguments


def _described(answer: EALData | int) -> dict[str, Any]:
    if not isinstance(answer, EALData):
        return {"value": answer}
    return {
        "value": plain(answer),
        "type": answer.type.value,
        "length": answer.length,
        "shape": None if answer.shape is None else list(answer.shape),
        "unit": answer.unit,
        "frame_id": answer.frame_id,
        "stamp_s": answer.stamp_s,
    }
