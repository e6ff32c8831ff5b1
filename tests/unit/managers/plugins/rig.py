"""The plugin of these tests."""

from __future__ import annotations

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

Write = Callable[..., Path]


def services() -> FleetServices:
    return FleetServices(ManualClock())
