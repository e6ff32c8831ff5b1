"""`eal bridge`: connect a fleet to another system, through a plugin that brings a bridge."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.text import Text

from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import FleetOption
from eal_actors.cli.output import print_line, service_output
from eal_actors.cli.plugin_settings import SettingOption, parse_settings
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.managers.plugins import EALPluginManager


def bridge_fleet(
    plugin: Annotated[str, typer.Argument(help="The plugin that brings the bridge, such as ros2.")],
    fleet: FleetOption,
    setting: SettingOption = None,
) -> None:
    """Connect the robots of a fleet to another system until Ctrl-C or SIGTERM; then all robots are halted.

    The page of the plugin lists its settings.
    """
    handle_signals()
    config = read_fleet(fleet)
    bridge, settings = EALPluginManager(config.plugin_dirs).bridge(plugin, parse_settings(setting or []))
    out = service_output()
    with Fleet(config).connect() as opened, bridge.open_bridge(opened, settings) as line:
        try:
            print_line(out, Text.assemble((config.name, "bold"), f": {line}; Ctrl-C ends it"))
            REAL_TIME.wait(new_waiter(), None)
        except KeyboardInterrupt:
            out.print("halting the robots")
