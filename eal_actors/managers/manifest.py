"""Plugin manifests: what `plugin.yaml` says, read before any code of the plugin runs."""

from __future__ import annotations

import importlib.metadata
import importlib.util
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, ValidationError

from eal_actors.device.info import unknown_name
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, EALError, PluginError
from eal_actors.kernel.strict_model import Name, StrictModel, Version1, problems_from
from eal_actors.kernel.yaml_source import load_yaml

ENTRY_POINTS: Final = "eal_actors.plugins"
"""The entry-point group of installed packages: a name, and the package whose folder holds the plugin."""

MANIFEST: Final = "plugin.yaml"


class ManifestFile(StrictModel):
    """What a plugin says of itself before it is imported."""

    version: Version1
    name: Name
    """The plugin's name, by which fleet files ask for it."""
    description: Annotated[str, Field(min_length=1)]
    """One line for people."""
    plugin_version: str
    """The plugin's own version."""
    resources: tuple[Name, ...] = Field(default=(), min_length=1, strict=False)
    """The resources that its `connect` names; left out where only its settings tell which these are."""
    requires: tuple[str, ...] = Field(default=(), strict=False)
    """Python modules that it imports beyond the framework's core."""
    uses: tuple[Name, ...] = Field(default=(), strict=False)
    """Other plugins whose modules it imports, as in `from ..mote_roomba.motion import Motion`."""
    extra: str | None = None
    """The extra of this distribution that installs them."""


@dataclass(frozen=True, slots=True)
class PluginManifest:
    """A plugin that was found.

    Attributes:
        folder: where it is.
        file: what its `plugin.yaml` says.
        others: the plugins that were found with it, by name, among them those that it uses.
    """

    folder: Path
    file: ManifestFile
    others: Mapping[str, PluginManifest] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """The plugin's name."""
        return self.file.name

    def used(self) -> tuple[PluginManifest, ...]:
        """Return the plugins that it uses, and those that they use, each after those that it uses itself.

        Raises:
            PluginError: one is not there, or they use one another in a circle.
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
            other._collect_used(found, way)  # noqa: SLF001  # a manifest like this one
            found[name] = other

    def missing_modules(self) -> tuple[str, ...]:
        """Return which modules, that it or a plugin that it uses requires, are not installed."""
        try:
            used = self.used()
        except PluginError:  # its import tells of that
            used = ()
        missing = [module for plugin in (self, *used) for module in plugin.own_missing_modules()]
        return tuple(dict.fromkeys(missing))

    def own_missing_modules(self) -> tuple[str, ...]:
        """Return which of the modules that it requires itself are not installed."""
        return tuple(module for module in self.file.requires if not _is_installed(module))


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # a parent that is missing, or imports badly
        return False


def read_manifest(folder: Path) -> PluginManifest:
    """Read the manifest in a plugin's folder; the plugins that it uses are looked for beside it and among the bundled.

    Raises:
        ConfigError: what is wrong with it.
    """
    manifest = _read_alone(folder)
    if not manifest.file.uses:
        return manifest
    others, _ = discover([folder.resolve().parent])
    return replace(manifest, others=others)


def _read_alone(folder: Path) -> PluginManifest:
    tree = load_yaml(folder / MANIFEST)
    try:
        return PluginManifest(folder, ManifestFile.model_validate(tree.root))
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, ManifestFile)) from None


def discover(plugin_dirs: Iterable[Path]) -> tuple[dict[str, PluginManifest], tuple[EALError, ...]]:
    """Find every plugin, importing none.

    Args:
        plugin_dirs: folders of plugin folders; an earlier one hides a plugin of the same name in a later one. The
            bundled plugins and those of installed packages come after them.

    Returns:
        The manifests by name, and what is wrong with the broken ones.
    """
    found: dict[str, PluginManifest] = {}
    errors: list[EALError] = []
    for folder in _plugin_folders(plugin_dirs, errors):
        try:
            manifest = replace(_read_alone(folder), others=found)
        except ConfigError as error:
            errors.append(error)
            continue
        found.setdefault(manifest.name, manifest)
    return dict(sorted(found.items())), tuple(errors)


def _plugin_folders(plugin_dirs: Iterable[Path], errors: list[EALError]) -> Iterable[Path]:
    for directory in [*plugin_dirs, bundled_path("plugins")]:
        if directory.is_dir():
            yield from sorted(manifest.parent for manifest in directory.glob(f"*/{MANIFEST}"))
        else:
            errors.append(PluginError(f"there is no folder of plugins at {directory}"))
    for entry in sorted(importlib.metadata.entry_points(group=ENTRY_POINTS), key=lambda entry: entry.name):
        spec = importlib.util.find_spec(entry.module.partition(".")[0])
        root = Path(spec.origin).parent if spec is not None and spec.origin is not None else None
        folder = root.joinpath(*entry.module.split(".")[1:]) if root is not None else None
        if folder is not None and (folder / MANIFEST).is_file():
            yield folder
        else:
            errors.append(PluginError(f"entry point {entry.name!r} names {entry.value!r}, which holds no {MANIFEST}"))
