"""Stand-ins: the emulator of a plugin's device, on a wire that can be pulled out.

A plugin's folder may hold a `conformance.py`:

- `wire(settings)`: what the device is connected by: `pty` for a serial port, `tcp` or `udp`; None if nothing stands in;
- `settings(address)`: the settings under which the plugin finds it at a device path, or at `host:port`;
- `emulate(settings)`: returns an emulator, with `feed(data, now_s) -> bytes`. It may have `complaints`, a sequence of
  texts that says what it could not make sense of.

`settings` of `wire` and `emulate` are those that the checks were given, such as `--setting link=mote`; those that name
a device themselves, by a key that `settings(address)` would set, get no stand-in.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

from eal_actors.kernel.errors import PluginError, error_text
from eal_actors.managers.manifest import PluginManifest
from eal_actors.managers.plugins import import_plugin
from eal_actors.testing.conformance.wires import WIRES, Wire


class StandIn:
    """An emulator that is plugged in, and the settings under which the plugin finds it.

    Attributes:
        settings: what a fleet file would say under the plugin's name.
    """

    def __init__(self, wire: Wire, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        self._wire = wire
        wire.plug_in()

    def plug_in(self) -> None:
        """Bring the device back, fresh, as if it had been switched off meanwhile."""
        self._wire.plug_in()

    def unplug(self) -> None:
        """Have the device vanish."""
        self._wire.unplug()

    def complaints(self) -> Sequence[str]:
        """Return what the emulator could not make sense of since it was plugged in. Thread: waits until it is heard."""
        self._wire.settle()
        complaints: Sequence[str] = getattr(self._wire.emulator, "complaints", ())
        return tuple(complaints)

    def close(self) -> None:
        """Remove it."""
        self._wire.close()


def stand_in_for(manifest: PluginManifest, settings: Mapping[str, Any]) -> StandIn | None:
    """Return a stand-in for a plugin's device; None if it has none, or the settings name a device themselves.

    Raises:
        PluginError: its `conformance.py` does not hold what it must.
    """
    if not (manifest.folder / "conformance.py").is_file():
        return None
    where = f"plugin {manifest.name!r}: conformance.py"
    package = import_plugin(manifest).__package__
    try:
        hook = importlib.import_module(f"{package}.conformance")
        return _plugged_in(hook, settings)
    except Exception as error:
        raise PluginError(f"{where}: {error_text(error)}") from error


def _plugged_in(hook: ModuleType, settings: Mapping[str, Any]) -> StandIn | None:
    kind = hook.wire(settings)
    if kind is None:
        return None
    wire = WIRES[kind](lambda: hook.emulate(settings))
    found = hook.settings(wire.address)
    if found.keys() & settings.keys():
        wire.close()
        return None
    return StandIn(wire, {**settings, **found})
