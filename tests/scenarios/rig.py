"""Fleets whose robots fail, delay or hang on demand, and scenarios written beside the assertions."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock, ScaledClock
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Scenario, load_scenario
from tests.plugin_files import write_plugin

RATE = 20.0
"""Seconds of fleet time in a real second, so that waits and time-outs are short."""

PLUGIN = """\
import threading

import numpy as np

from eal_actors.plugin import (
    DataType, EALPlugin, PluginSettingsModel, PluginError, Resource, ResourceType, ValueInfo, command, config,
    config_setter, request,
)


class Settings(PluginSettingsModel):
    failures: int = 0
    slowness: float = 1.0
    is_broken: bool = False
    fails_to_open: bool = False
    refuses_halt: bool = False


class Base(Resource):
    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.INT, minimum=0, maximum=9)

    def __init__(self, settings):
        self.settings = settings
        self.counts = {"halts": 0, "tries": 0, "stops": 0}
        self.gain_value = 1.0
        self.number = 0

    def open(self):
        if self.settings.fails_to_open:
            raise OSError("no such port")

    def halt(self):
        self.counts["halts"] += 1
        if self.settings.refuses_halt:
            raise RuntimeError("no brakes")

    def get_value(self):
        return self.number

    def set_value(self, data):
        self.number = data.value

    @command("now")
    def now(self):
        self.counts["tries"] += 1

    @command("go<seconds>", ValueInfo(DataType.DOUBLE, "s", 0, 100))
    def go(self, seconds):
        yield seconds * self.settings.slowness

    @command("fail")
    def fail(self):
        self.counts["tries"] += 1
        raise RuntimeError("out of order")

    @command("flaky")
    def flaky(self):
        self.counts["tries"] += 1
        if self.counts["tries"] <= self.settings.failures:
            raise RuntimeError(f"try {self.counts['tries']}")

    @command("hang")
    def hang(self):
        if self.settings.failures:
            never = threading.Event()
            while not never.wait(0.01):
                pass

    @command("say", ValueInfo(DataType.CHAR))
    def say(self, text):
        self.said = text

    @command("s", urgent=True)
    def stop(self):
        self.counts["stops"] += 1

    @request("said")
    def said_request(self):
        return self.said

    @request("halts", ValueInfo(DataType.INT))
    def halts(self):
        return self.counts["halts"]

    @request("tries", ValueInfo(DataType.INT))
    def tries(self):
        return self.counts["tries"]

    @request("stops", ValueInfo(DataType.INT))
    def stops(self):
        return self.counts["stops"]

    @config("gain", ValueInfo(DataType.DOUBLE, minimum=0, maximum=1))
    def gain(self):
        return self.gain_value

    @config_setter("gain")
    def set_gain(self, gain):
        self.gain_value = gain

    @config("serial", ValueInfo(DataType.INT))
    def serial(self):
        return 7


class Eye(Resource):
    types = ResourceType.SENSOR

    def __init__(self):
        self.frames = 0

    def get_value(self):
        image = np.zeros((2, 3, 3), dtype=np.uint8)
        image[..., 0] = 200
        return image

    @request("name")
    def name_request(self):
        return "eye"

    @request("frame")
    def frame(self):
        self.frames += 1
        return [self.frames, 0]


def connect(context):
    if context.settings.is_broken:
        raise PluginError("unplugged")
    return EALPlugin("Base", "Eye")


def create_Base(context):
    return Base(context.settings)
"""

HEAD = """\
version: 1
name: trial
description: A trial.
roles:
  all: {}
"""


def write_fleet(folder: Path, robots: Mapping[str, Mapping[str, Any]], head: str = "") -> Path:
    """Write the plugin and a fleet file; each robot's mapping is the rig's settings, and `tags`."""
    write_plugin(folder, "rig", PLUGIN, "Base", "Eye")
    lines = ["version: 1", "name: rigs", "plugin_dirs: [plugins]", *head.splitlines(), "robots:"]
    for name, settings in robots.items():
        rig = {key: value for key, value in settings.items() if key != "tags"}
        shown = ", ".join(f"{key}: {str(value).lower()}" for key, value in rig.items())
        lines.append(f"  {name}: {{tags: [{', '.join(settings.get('tags', []))}], plugins: {{rig: {{{shown}}}}}}}")
    path = folder / "fleet.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


@contextmanager
def rigs(folder: Path, *, clock: Clock | None = None, head: str = "", **robots: Mapping[str, Any]) -> Iterator[Fleet]:
    """Connect a fleet of rigs; by default its clock is fast."""
    config = EALConfigManager.load(write_fleet(folder, robots, head), environment={}).fleet
    fleet = Fleet(config, clock or ScaledClock(RATE))
    with fleet:
        yield fleet


def scenario(folder: Path, body: str, head: str = HEAD) -> Scenario:
    """Write a scenario and load it."""
    path = folder / "trial.yaml"
    path.write_text(head + textwrap.dedent(body))
    return load_scenario(path)


def ask(fleet: Fleet, robot: str, count: str) -> int:
    """Return one of the counts of a robot's base."""
    value: int = fleet[robot]["Base"].send_req(count).get().value
    return value
