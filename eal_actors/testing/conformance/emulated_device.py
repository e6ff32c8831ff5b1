"""The emulator of a plugin's device on a wire that the checks can cut.

The manifest's `emulator` declares the wire, the settings that lead the driver to it, and the module. The module's
`emulate(settings, now_s)` returns an object with `feed(data, now_s) -> bytes`, which may have `complaints`, a sequence
of texts on input that made no sense; it returns None for settings without an emulator. `settings` are those of the
check, such as `--setting link=mote`; settings that name a device themselves get no emulator.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eal_actors.device.emulator_wires import WIRES, EmulatorWire
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import PluginError, error_text
from eal_actors.managers.manifest import EmulatorSection, PluginManifest
from eal_actors.managers.plugins import import_plugin


@dataclass(frozen=True, slots=True)
class EmulatedDevice:
    """An emulator on its wire, and the settings that lead the plugin to it."""

    wire: EmulatorWire
    settings: Mapping[str, Any]

    def complaints(self) -> Sequence[str]:
        """Return the emulator's complaints since it was plugged in. Thread: waits until it has read everything."""
        self.wire.drain()
        complaints: Sequence[str] = getattr(self.wire.emulator, "complaints", ())
        return tuple(complaints)


def emulate_device(manifest: PluginManifest, settings: Mapping[str, Any]) -> EmulatedDevice | None:
    """Return the emulator of a plugin's device; None if there is none, or the settings name a device themselves.

    Raises PluginError if the declared emulator does not work.
    """
    section = manifest.file.emulator
    if section is None or section.wire is None or section.settings.keys() & settings.keys():
        return None
    try:
        return _connect(manifest, section, settings)
    except Exception as error:
        raise PluginError(f"plugin {manifest.name!r}: emulator {section.module}.py: {error_text(error)}") from error


def _connect(manifest: PluginManifest, section: EmulatorSection, settings: Mapping[str, Any]) -> EmulatedDevice | None:
    package = import_plugin(manifest).__package__
    emulate = importlib.import_module(f"{package}.{section.module}").emulate
    if section.wire is None or emulate(settings, REAL_TIME.now) is None:
        return None
    wire = WIRES[section.wire](lambda: emulate(settings, REAL_TIME.now))
    wire.plug_in()
    return EmulatedDevice(wire, {**settings, **section.driver_settings(wire.address)})
