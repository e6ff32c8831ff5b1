"""Exit codes and error messages: the only place that maps errors to either."""

from __future__ import annotations

import enum
import re
import traceback
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Final

from rich.console import Console
from rich.text import Text

from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.output import counted, stderr, write_json
from eal_actors.cli.problems import print_problems
from eal_actors.kernel import errors
from eal_actors.kernel.log import get_logger


class ExitCode(enum.IntEnum):
    """An exit code of `eal`."""

    DONE = 0
    FAILED = 1
    BAD_INPUT = 2
    UNREACHABLE = 3
    INTERRUPTED = 130


EPILOG: Final = (
    "Exit codes: 0 done; 1 the scenario, call or plugin check failed; 2 wrong input: a file, a name, an argument; "
    "3 a robot could not be reached; 130 interrupted."
)

TROUBLESHOOTING: Final = "https://github.com/eal-actors/eal-actors/blob/main/docs/troubleshooting.md"
"""The page with a paragraph for each error code."""
SEE_DEVICE: Final = "Check that it is switched on and connected, then try again."
"""Advice if a device may be the cause."""
SEE_BLOCKING: Final = "A command blocks its actor: `eal plugin check FOLDER` names the command."
"""Advice if more time would not help."""
SEE_PLUGIN: Final = "The plugin's code failed there, not the device: `eal plugin check FOLDER` tests it."
"""Advice if a line of a plugin raised."""
SEE_HOLDER: Final = "Stop that program; `eal ports` lists the serial ports and the programs that hold them."
"""Advice if another program has the device open."""
SEE_RULE: Final = "docs/robots.md has a udev rule that gives a device to a group."
"""Advice if no group may open the device."""
SEE_PORT: Final = "`ss -ltnp` shows the program: stop it, or choose another port."
"""Advice if another program uses the port."""

_FORBIDDEN: Final = re.compile(r"the group (\S+) may open it, and (\S+) has not been in it")
_PLUGIN_LINE: Final = re.compile(r"\(at \S+:\d+\)")
_RESOURCES: Final = "`eal resources --fleet FLEET --robot ROBOT` lists resources and their commands."
_TABLE: Final[tuple[tuple[type[errors.EALError], ExitCode, str], ...]] = (
    (errors.ConfigError, ExitCode.BAD_INPUT, ""),
    (errors.RobotNotFoundError, ExitCode.BAD_INPUT, "`eal resources --fleet FLEET` lists the robots."),
    (errors.ResourceNotFoundError, ExitCode.BAD_INPUT, _RESOURCES),
    (errors.PlaceNotFoundError, ExitCode.BAD_INPUT, "`eal world FILE` lists the places of a world."),
    (errors.UnsupportedError, ExitCode.BAD_INPUT, ""),
    (errors.ArgumentError, ExitCode.BAD_INPUT, _RESOURCES),
    (errors.DataError, ExitCode.BAD_INPUT, ""),
    (errors.RobotFailedError, ExitCode.UNREACHABLE, SEE_DEVICE),
    (errors.UnavailableError, ExitCode.UNREACHABLE, SEE_DEVICE),
    (errors.RemoteError, ExitCode.UNREACHABLE, ""),
    (errors.PluginError, ExitCode.UNREACHABLE, "Details: `eal plugin check FOLDER`"),
    (errors.DeadlineError, ExitCode.FAILED, "If it needs more time, raise --timeout-s, or timeout_s in the file."),
    (errors.BusyError, ExitCode.FAILED, "Wait until the robot has worked off its queue, then try again."),
    (errors.EALError, ExitCode.FAILED, ""),
)


def exit_code(error: errors.EALError) -> ExitCode:
    """Return the exit code of an error."""
    return _row(error)[1]


def report_error(
    error: errors.EALError, options: GlobalOptions, *, as_json: bool = False, console: Console | None = None
) -> ExitCode:
    """Print an error and what to do next on stderr, or a console; return its exit code.

    `--log-format json` makes it a log line; `--log-level debug` adds the traceback. In a command with `--json`, it is
    JSON on stdout, in place of the result.
    """
    code, advice = exit_code(error), _advice(error)
    if as_json:
        write_error(error.code, str(error), code, advice, getattr(error, "problems", ()))
        return code
    if options.log_format == "json":
        get_logger().error(str(error), code=error.code, exit_code=int(code), exc_info=options.log_level == "debug")
        return code
    console = console or stderr()
    if options.log_level == "debug":
        console.print("".join(traceback.format_exception(error)), end="", soft_wrap=True)
    if isinstance(error, errors.ConfigError):
        print_problems(console, error.problems)
        advice = f"{counted(len(error.problems), 'problem')}; nothing was done."
    else:
        console.print(Text.assemble(("Error: ", "bold red"), str(error)), soft_wrap=True)
    if advice:
        console.print(advice, style="dim", soft_wrap=True)
    console.print(f"{error.code}: {TROUBLESHOOTING}#{error.code}", style="dim", soft_wrap=True, highlight=False)
    return code


def write_error(
    name: str, message: str, code: ExitCode, advice: str = "", problems: Sequence[errors.Problem] = ()
) -> None:
    """Write an error to stdout as JSON, in place of the result of a command with `--json`."""
    about: dict[str, Any] = {"code": name, "message": message, "exit_code": int(code), "advice": advice}
    about["url"] = f"{TROUBLESHOOTING}#{name}"
    write_json({"error": {**about, "problems": [asdict(problem) for problem in problems]}})


def _advice(error: errors.EALError) -> str:
    """Return what to do about an error: its notes, which are more specific, or the advice of the table."""
    if notes := getattr(error, "__notes__", ()):
        return "\n".join(notes)
    in_use = ("the port is in use", "Address already in use")
    if isinstance(error, errors.UnavailableError) and any(words in error.message for words in in_use):
        return SEE_PORT
    if isinstance(error, errors.RobotFailedError | errors.UnavailableError) and "abandoned" in error.message:
        return SEE_BLOCKING
    if isinstance(error, errors.RobotFailedError | errors.UnavailableError) and _PLUGIN_LINE.search(error.message):
        return SEE_PLUGIN
    if isinstance(error, errors.ArgumentError) and error.resource is None:
        return ""  # no command of a resource: its message says what to correct
    return advise_on_device(error.message) or _row(error)[2]


def advise_on_device(message: str) -> str:
    """Return what to do about a device that this user may not open or that another program holds; else nothing."""
    if (forbidden := _FORBIDDEN.search(message)) is not None:
        return "`sudo usermod -aG {} {}`, then log out and in again.".format(*forbidden.groups())
    if "only root may open it" in message:
        return SEE_RULE
    if "have it open" in message:
        return SEE_HOLDER.replace("that program", "those programs")
    return SEE_HOLDER if "has it open" in message else ""


def _row(error: errors.EALError) -> tuple[type[errors.EALError], ExitCode, str]:
    return next(row for row in _TABLE if isinstance(error, row[0]))
