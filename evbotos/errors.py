"""Errors of builds and installations; an invalid definition is a ConfigError."""

from __future__ import annotations

from typing import Final

from eal_actors.kernel.errors import EALError

RESUME: Final = "free space and build again, finished steps are kept"


class BuildError(EALError, RuntimeError):
    """A build step failed; names the step, the cause and its log."""

    code = "build"


class DiskFullError(BuildError):
    """The disk of the build machine is full; finished steps are kept."""


class MissingToolsError(EALError, LookupError):
    """Programs are missing on the build machine; lists all of them with their packages."""

    code = "missing_tools"


class FlashError(EALError, RuntimeError):
    """A device must not be written, or did not keep the written data."""

    code = "flash"


class UpdateError(EALError, RuntimeError):
    """An update cannot be created: its key is missing or invalid."""

    code = "update"
