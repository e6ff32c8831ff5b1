"""Plugin manifests: `plugin.yaml`, which is read before any code of the plugin runs.

The framework knows no plugin by name. A plugin that replays, simulates, emulates or opens devices declares it here, so
that `eal rehearse`, `eal lab`, `eal replay` and `eal doctor` treat bundled plugins and plugins of others alike.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, PositiveFloat

from eal_actors.device.info import unknown_name
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, EALError, PluginError
from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1, model_of
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.kernel.yaml_tree import texts_in

ENTRY_POINTS: Final = "eal_actors.plugins"
"""The entry-point group of installed packages: a name, and the package whose folder contains the plugin."""

MANIFEST: Final = "plugin.yaml"

Text = Annotated[str, Field(min_length=1)]
Identifier = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]

Arguments = Annotated[tuple[str, ...], Field(strict=False)]


class TwinSection(StrictModel):
    """The simulated robot that replaces the driver's robot in `eal rehearse`, `eal sweep` and scenario tests."""

    plugin: Name
    """The plugin that simulates the robot, which must declare `simulation`; or, of a sensor, the plugin itself."""
    settings: dict[str, Any] = Field(default={})
    """The settings of that plugin, such as `model`; of a sensor, one is a port in the simulated world, `sim://world`."""


class FaultSection(StrictModel):
    """A fault that `eal prove` injects into a simulated robot while it performs a step."""

    settings: dict[str, Any] = Field(min_length=1)
    """An entry of the plugin's setting `faults`, without its times. `{resource}` is the resource of the step."""
    lasts_s: PositiveFloat | None = None
    """How long it lasts, in seconds of the fleet's clock; left out, to the end of the run."""
    resources: tuple[Name, ...] = Field(default=(), strict=False)
    """It is tried in calls of these resources, and in steps that may call any; left out, in all steps."""
    unreachable: bool = False
    """Nobody reaches the robot meanwhile, so nobody can halt it at the end of the run."""


class SimulationSection(StrictModel):
    """Declares that the plugin simulates robots, perhaps in a shared world."""

    scheme: Annotated[str, Field(pattern=r"^[a-z][a-z0-9+.-]*$")] | None = None
    """Scheme of its simulated ports: a driver joins the robot `NAME` of the world at `<scheme>://world/NAME`. It
    defaults to the plugin's name."""
    faults: dict[Name, FaultSection] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """The faults that `eal prove` tries, by name. The plugin's setting `faults` is a list of faults, each with the
    times `at_s` and `until_s` of the fleet's clock."""


class EmulatorSection(StrictModel):
    """Emulates the device at the other end of the driver's wire."""

    module: Identifier = "emulator"
    """Module of the plugin that contains the emulator."""
    wire: Literal["pty", "tcp", "udp"] | None = None
    """How `eal plugin check` connects `emulate(settings, now_s)` of the module; left out, it does not."""
    world_wire: Literal["pty", "tcp", "udp"] | None = None
    """How `eal lab` connects `emulate_in_world(context, url)` of the module, if the fleet has a world; left out, the
    device is not in the world."""
    settings: dict[str, str] = Field(default={})
    """Settings that lead the driver to the wire. `{address}` is a device path or `host:port`, `{host}` and `{port}` are
    its parts; `{port}` alone becomes a number."""
    arguments: Arguments | None = None
    """Arguments with which `eal lab` runs the module as a program, which prints the value of the setting in its first
    line, and at its end `pose X m Y m YAW deg`; left out, `eal lab` serves `emulate` on the wire."""
    options: dict[str, dict[str, Arguments]] = Field(default={})
    """Further arguments by setting and by its value, such as `link: {radio: [--radio]}`."""

    def program_arguments(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the arguments of the program for a driver with these settings."""
        found = (values.get(str(settings.get(name)), ()) for name, values in self.options.items())
        return (*(self.arguments or ()), *(argument for some in found for argument in some))

    def driver_settings(self, address: str) -> dict[str, Any]:
        """Return the settings that lead the driver to an address."""
        host, _, port = address.rpartition(":")
        return {
            key: int(port) if text == "{port}" else text.format(address=address, host=host, port=port)
            for key, text in self.settings.items()
        }


class DeviceSection(StrictModel):
    """A device that a setting of the plugin names; `eal doctor` looks for it."""

    setting: Name
    """The setting."""
    kind: Literal["serial", "camera", "other"] = "other"
    """The kind of device. A number in the setting of a `camera` is that of /dev/video."""
    usb: tuple[Annotated[str, Field(pattern=r"^[0-9a-f]{4}:[0-9a-f]{4}$")], ...] = Field(default=(), strict=False)
    """Vendor and product ids of the device or of its usual USB adapters, such as `0403:6001`."""
    group: Text = "dialout"
    """The group that usually may open it."""


class ManifestFile(StrictModel):
    """The manifest of a plugin."""

    version: Version1
    name: Name
    """The plugin's name in fleet files."""
    description: Text
    """One line for people."""
    plugin_version: str
    """The plugin's own version."""
    resources: tuple[Name, ...] = Field(default=(), min_length=1, strict=False)
    """The resources that its `connect` names; left out if they depend on its settings."""
    requires: tuple[str, ...] = Field(default=(), strict=False)
    """Python modules that it imports beyond the framework's core."""
    uses: tuple[Name, ...] = Field(default=(), strict=False)
    """Other plugins whose modules it imports, as in `from ..lift.motor import Motor`."""
    extra: str | None = None
    """The extra of this distribution that installs the required modules."""
    twin: TwinSection | None = None
    simulation: SimulationSection | None = None
    replays: bool = False
    """Whether it plays a recorded robot for `eal replay`, by its settings `record` and `loop`."""
    emulator: EmulatorSection | None = None
    bridge: Identifier | None = None
    """Module of the plugin that connects a whole fleet to another system, for `eal bridge`."""
    devices: tuple[DeviceSection, ...] = Field(default=(), strict=False)
    """The devices that its settings name."""
    quick: dict[str, Any] = Field(default={})
    """Settings with which a simulation is quicker and nobody sees a picture; `eal prove` adds them."""
    former_names: dict[Name, Text] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Former names in fleet files, and their replacements."""


@dataclass(frozen=True, slots=True)
class PluginManifest:
    """A discovered plugin.

    `others` are the plugins that were discovered with it, by name; those that it uses are looked up there.
    """

    folder: Path
    file: ManifestFile
    others: Mapping[str, PluginManifest] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """The plugin's name."""
        return self.file.name

    def used(self) -> tuple[PluginManifest, ...]:
        """Return the plugins that it uses, directly or not, each after those that it uses itself.

        Raises PluginError if one is missing, or they use one another in a circle.
        """
        found: dict[str, PluginManifest] = {}
        self._collect_used(found, ())
        return tuple(found.values())

    def _collect_used(self, found: dict[str, PluginManifest], way: tuple[str, ...]) -> None:
        way = (*way, self.name)
        for name in self.file.uses:
            if name in way:
                circle = " -> ".join([*way[way.index(name) :], name])
                raise PluginError(f"plugin {way[0]!r}: plugins use one another in a circle: {circle}")
            if name in found:
                continue
            if (other := self.others.get(name)) is None:
                raise PluginError(f"plugin {self.name!r} uses another one: {unknown_name('plugin', name, self.others)}")
            other._collect_used(found, way)  # noqa: SLF001  # same class
            found[name] = other

    def missing_modules(self) -> tuple[str, ...]:
        """Return the modules that it, or a plugin that it uses, requires and that are not installed."""
        try:
            used = self.used()
        except PluginError:  # importing it reports this
            used = ()
        return tuple(dict.fromkeys(module for plugin in (self, *used) for module in plugin.own_missing_modules()))

    def own_missing_modules(self) -> tuple[str, ...]:
        """Return the modules that it requires itself and that are not installed."""
        return tuple(module for module in self.file.requires if not _is_installed(module))

    def lacks(self, user: PluginManifest | None = None) -> str:
        """Return which modules are not installed and how to install them, perhaps for a plugin that uses it; or ""."""
        missing = self.own_missing_modules()
        if not missing:
            return ""
        remedy = f"'eal-actors[{self.file.extra}]'" if self.file.extra else " ".join(missing)
        whose = "" if user in (None, self) else f" for the plugin {self.name!r}, which it uses"
        return f"plugin {(user or self).name!r} needs {', '.join(missing)}{whose}: pip install {remedy}"

    def contradictions(self) -> list[str]:
        """Return the declarations that its folder and the other plugins do not fulfil."""
        found = []
        modules = {"emulator": self.file.emulator and self.file.emulator.module, "bridge": self.file.bridge}
        for key, module in modules.items():
            if module is not None and not (self.folder / f"{module}.py").is_file():
                found.append(f"{key}: there is no {module}.py in {self.folder}")
        if (twin := self.file.twin) is not None:
            if (other := self.others.get(twin.plugin)) is None:
                found.append(f"twin: {unknown_name('plugin', twin.plugin, self.others)}")
            elif other.file.simulation is None and not names_world(twin.settings, self.others):
                found.append(
                    f"twin: the plugin {twin.plugin!r} declares no simulation; if it is one, give it "
                    "`simulation: {}`; the twin of a sensor has a port such as sim://world among its settings"
                )
        if self.file.emulator is None and (self.folder / "conformance.py").is_file():
            found.append("conformance.py is not read; declare `emulator` in plugin.yaml")
        return found


def world_urls(manifests: Mapping[str, PluginManifest]) -> dict[str, str]:
    """Return, by the plugin that simulates it, the URL of a simulated world, under which its ports are."""
    return {
        name: f"{simulation.scheme or name}://world"
        for name, manifest in manifests.items()
        if (simulation := manifest.file.simulation) is not None
    }


def names_world(settings: object, manifests: Mapping[str, PluginManifest]) -> bool:
    """Return whether a text in settings is a port or a camera of a simulated world."""
    return any(text.startswith(tuple(world_urls(manifests).values())) for text in texts_in(settings))


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # a parent that is missing, or imports badly
        return False


def read_manifest(folder: Path) -> PluginManifest:
    """Read the manifest in a plugin's folder; its neighbours and the bundled plugins are discovered with it.

    Raises ConfigError with the problems of the file.
    """
    manifest = PluginManifest(folder, _read_file(folder))
    others, _ = discover([folder.resolve().parent])
    return replace(manifest, others=others)


def _read_file(folder: Path) -> ManifestFile:
    file = folder / MANIFEST
    try:
        changed_ns = file.stat().st_mtime_ns
    except OSError:
        changed_ns = 0  # load_yaml reports it
    return _parse_file(file, changed_ns)


@lru_cache(maxsize=256)
def _parse_file(file: Path, changed_ns: int) -> ManifestFile:  # noqa: ARG001  # part of the cache's key
    return model_of(ManifestFile, load_yaml(file))


def discover(plugin_dirs: Iterable[Path]) -> tuple[dict[str, PluginManifest], tuple[EALError, ...]]:
    """Find every plugin, importing none; return the manifests by name, and the errors of the broken ones.

    A folder of plugins hides plugins of the same names in later ones. The bundled plugins and those of installed
    packages come last.
    """
    found: dict[str, PluginManifest] = {}
    errors: list[EALError] = []
    for folder in _plugin_folders(plugin_dirs, errors):
        try:
            manifest = PluginManifest(folder, _read_file(folder), found)
            found.setdefault(manifest.name, manifest)
        except ConfigError as error:
            errors.append(error)
    return dict(sorted(found.items())), tuple(errors)


def explain_unknown_plugin(name: str, manifests: Mapping[str, PluginManifest], errors: Iterable[EALError]) -> str:
    """Return the message for a plugin that `discover` did not find, from what it returned."""
    for manifest in manifests.values():
        if (remedy := manifest.file.former_names.get(name)) is not None:
            return f"the plugin {name!r} is now part of {manifest.name!r}: write {remedy}"
    unread = "; ".join(map(str, errors))
    return unknown_name("plugin", name, manifests) + (f" (could not be read: {unread})" if unread else "")


def _plugin_folders(plugin_dirs: Iterable[Path], errors: list[EALError]) -> Iterable[Path]:
    for directory in [*plugin_dirs, bundled_path("plugins")]:
        if directory.is_dir():
            yield from sorted(manifest.parent for manifest in directory.glob(f"*/{MANIFEST}"))
        else:
            errors.append(PluginError(f"there is no folder of plugins at {directory}"))
    for entry in _entry_points(tuple(sys.path)):
        spec = importlib.util.find_spec(entry.module.partition(".")[0])
        root = Path(spec.origin).parent if spec is not None and spec.origin is not None else None
        folder = root.joinpath(*entry.module.split(".")[1:]) if root is not None else None
        if folder is not None and (folder / MANIFEST).is_file():
            yield folder
        else:
            absent = "is not installed (`pip install -e` cannot: use plugin_dirs)"
            lack = absent if spec is None else f"holds no {MANIFEST}"
            errors.append(PluginError(f"entry point {entry.name!r} names {entry.value!r}, which {lack}"))


@cache
def _entry_points(_path: tuple[str, ...]) -> tuple[importlib.metadata.EntryPoint, ...]:
    """Return the plugins of installed packages; reading those of all packages takes 30 ms, a third of a short run."""
    return tuple(sorted(importlib.metadata.entry_points(group=ENTRY_POINTS), key=lambda entry: entry.name))


def simulating_plugin(plugin_dirs: Iterable[Path] = ()) -> PluginManifest:
    """Return the plugin that simulates robots; of several, the bundled one. Raises PluginError if there is none."""
    return _declaring(plugin_dirs, lambda file: file.simulation is not None, "simulates robots (simulation)")


def replaying_plugin(plugin_dirs: Iterable[Path] = ()) -> PluginManifest:
    """Return the plugin that plays recorded robots; of several, the bundled one; PluginError if there is none."""
    return _declaring(plugin_dirs, lambda file: file.replays, "plays recorded robots (replays)")


def _declaring(plugin_dirs: Iterable[Path], declares: Callable[[ManifestFile], bool], what: str) -> PluginManifest:
    manifests, _ = discover(plugin_dirs)
    found = [manifest for manifest in manifests.values() if declares(manifest.file)]
    if not found:
        raise PluginError(f"no plugin declares that it {what}")
    bundled = bundled_path("plugins")
    return min(found, key=lambda manifest: manifest.folder.parent != bundled)
