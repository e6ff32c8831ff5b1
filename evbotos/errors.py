"""What can go wrong beside a wrong definition, which is a ConfigError."""

from __future__ import annotations

from eal_actors.kernel.errors import EALError


class BuildError(EALError, RuntimeError):
    """A step of a build that failed: which one, with what, and where its log is."""

    code = "build"


class DiskFullError(BuildError):
    """The disk of the build machine is full; steps that were finished are kept."""


class MissingToolsError(EALError, LookupError):
    """Programs of the build machine that are not installed: all of them, with the packages that have them."""

    code = "missing_tools"


class FlashError(EALError, RuntimeError):
    """A device that must not be written, or that did not keep what was written."""

    code = "flash"


class UpdateError(EALError, RuntimeError):
    """An update that cannot be made: its key is not there, or is none."""

    code = "update"
