"""Checks the map file that a fleet file names."""

from __future__ import annotations

from pathlib import Path

from eal_actors.kernel.errors import ConfigError, Problem, UnsupportedError


def map_problems(path: Path) -> tuple[Problem, ...]:
    """Return what is wrong with a map file; nothing where it cannot be read for want of numpy or Pillow.

    Such a board serves its robots all the same, and plans no paths.
    """
    try:
        from eal_actors.device.navigation.map_file import load_map

        load_map(path)
    except (ImportError, UnsupportedError):
        return ()
    except ConfigError as error:
        return tuple(error.problems)
    return ()
