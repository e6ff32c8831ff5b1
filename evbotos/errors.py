"""Errors of builds and installations; an invalid definition is a ConfigError."""

from __future__ import annotations

from typing import Final

from eal_actors.kernel.errors import EALError

RESUME: Final = "free space and build again, finished steps are kept"


class BuildError(EALError, RuntimeError, code="build"):
    """A build step failed; names the step, the cause and its log."""


class DiskFullError(BuildError):
    """The disk of the build machine is full; finished steps are kept."""


class MissingToolsError(EALError, LookupError, code="missing_tools"):
    """Programs are missing on the build machine; lists all of them with their packages."""


class FlashError(EALError, RuntimeError, code="flash"):
    """A device must not be written, or did not keep the written data."""


class UpdateError(EALError, RuntimeError, code="update"):
    """An update cannot be created: its key is missing or invalid."""
