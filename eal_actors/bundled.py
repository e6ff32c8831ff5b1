"""Find the plugins, fleets and scenarios that come with the framework, in a checkout and in an installed wheel."""

from __future__ import annotations

from pathlib import Path


def bundled_path(name: str) -> Path:
    """Return a shipped file or folder, such as `plugins` or `fleets/local.yaml`."""
    package = Path(__file__).parent
    installed = package / "_bundled"
    return (installed if installed.is_dir() else package.parent) / name
