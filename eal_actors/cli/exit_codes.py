"""Exit codes, and how an error is told: the one table of both."""

from __future__ import annotations

import enum
import traceback
from typing import Final

from rich.text import Text

from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.output import stderr
from eal_actors.kernel.errors import (
    ArgumentError,
    BusyError,
    ConfigError,
    DataError,
    DeadlineError,
    EALError,
    PluginError,
    RemoteError,
    ResourceNotFoundError,
    RobotFailedError,
    RobotNotFoundError,
    UnavailableError,
    UnsupportedError,
)
from eal_actors.kernel.log import get_logger


class ExitCode(enum.IntEnum):
    """What `eal` tells the shell."""

    DONE = 0
    FAILED = 1
    BAD_INPUT = 2
    UNREACHABLE = 3
    INTERRUPTED = 130


EPILOG: Final = (
    "Exit codes: 0 done; 1 the scenario, call or plugin check failed; 2 wrong input: a file, a name, an argument; "
    "3 a robot could not be reached; 130 interrupted."
)

SEE_DEVICE: Final = "See that it is switched on and connected, then try again."
"""Advice where a device may be the cause."""
SEE_BLOCKING: Final = "Something blocks its actor: `eal plugin check FOLDER` tells which command."
"""Advice where more time would not help."""
SEE_PORT: Final = "`ss -ltnp` tells which program that is: end it, or name another port."
"""Advice where another program has the port."""

_RESOURCES: Final = "`eal resources --fleet FLEET --robot ROBOT` shows what there is."
_TABLE: Final[tuple[tuple[type[EALError], ExitCode, str], ...]] = (
    (ConfigError, ExitCode.BAD_INPUT, ""),
    (RobotNotFoundError, ExitCode.BAD_INPUT, "`eal resources --fleet FLEET` lists the robots."),
    (ResourceNotFoundError, ExitCode.BAD_INPUT, _RESOURCES),
    (UnsupportedError, ExitCode.BAD_INPUT, ""),
    (ArgumentError, ExitCode.BAD_INPUT, _RESOURCES),
    (DataError, ExitCode.BAD_INPUT, ""),
    (RobotFailedError, ExitCode.UNREACHABLE, SEE_DEVICE),
    (UnavailableError, ExitCode.UNREACHABLE, SEE_DEVICE),
    (RemoteError, ExitCode.UNREACHABLE, ""),
    (PluginError, ExitCode.UNREACHABLE, "`eal plugin check FOLDER` tells more."),
    (
        DeadlineError,
        ExitCode.FAILED,
        "If it just takes long, give it more time: --timeout-s, or timeout_s in the file.",
    ),
    (BusyError, ExitCode.FAILED, "Wait until the robot has caught up, then try again."),
    (EALError, ExitCode.FAILED, ""),
)


def exit_code(error: EALError) -> ExitCode:
    """Return the exit code of an error."""
    return _row(error)[1]


def report(error: EALError, options: GlobalOptions) -> ExitCode:
    """Tell an error on stderr, with what to do next, and return its exit code.

    With `--log-format json` it is a log line; with `--log-level debug` it comes with its traceback.
    """
    code, advice = exit_code(error), _advice(error)
    if options.log_format == "json":
        get_logger().error(str(error), code=error.code, exit_code=int(code), exc_info=options.log_level == "debug")
        return code
    console = stderr()
    if options.log_level == "debug":
        console.print("".join(traceback.format_exception(error)), end="", soft_wrap=True)
    if isinstance(error, ConfigError):
        for problem in error.problems:
            console.print(str(problem), soft_wrap=True)
        advice = f"{len(error.problems)} problem{'s' * (len(error.problems) != 1)}; nothing was done."
    else:
        console.print(Text.assemble(("Error: ", "bold red"), str(error)), soft_wrap=True)
    if advice:
        console.print(advice, style="dim", soft_wrap=True)
    return code


def _advice(error: EALError) -> str:
    """Return what to do about an error: as its notes say, who know more of it, or as the table says."""
    notes = getattr(error, "__notes__", ())
    if notes:
        return "\n".join(notes)
    if _found_no_port(error):
        return SEE_PORT
    return SEE_BLOCKING if _was_stuck(error) else _row(error)[2]


def _was_stuck(error: EALError) -> bool:
    return isinstance(error, RobotFailedError | UnavailableError) and "abandoned" in error.message


def _found_no_port(error: EALError) -> bool:
    taken = ("the port is in use", "Address already in use")
    return isinstance(error, UnavailableError) and any(words in error.message for words in taken)


def _row(error: EALError) -> tuple[type[EALError], ExitCode, str]:
    return next(row for row in _TABLE if isinstance(error, row[0]))
