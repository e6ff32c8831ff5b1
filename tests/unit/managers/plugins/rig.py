"""The plugin of these tests."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from eal_actors.plugin import FleetServices
from tests.manual_clock import ManualClock

MANIFEST = """\
version: 1
name: {name}
description: A plugin of a test.
plugin_version: "1.2"
resources: [{resources}]
"""

CODE = """\
from eal_actors.plugin import EALPlugin, Resource

LOG = []

class Thing(Resource):
    def get_value(self):
        return 1

def connect():
    LOG.append("connect")
    return EALPlugin("Thing")

def disconnect(plugin):
    LOG.append("disconnect")

def create_Thing():
    return Thing()

def destroy_Thing(resource):
    LOG.append("destroy")
"""


def unload(folder: Path) -> None:
    """Remove the modules of a plugin's folder, so that a plugin of the same name can be imported."""
    for name, module in list(sys.modules.items()):
        if name.startswith("eal_plugins.") and str(folder.resolve()) in getattr(module, "__path__", []):
            for part in [part for part in sys.modules if part == name or part.startswith(f"{name}.")]:
                del sys.modules[part]


Write = Callable[..., Path]


def services() -> FleetServices:
    return FleetServices(ManualClock())
