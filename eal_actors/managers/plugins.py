"""EALPluginManager: imports a robot's plugins, connects them, and offers their resources."""

from __future__ import annotations

import importlib.util
import inspect
import math
import os
import sys
import threading
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import ValidationError
from typing_extensions import override

from eal_actors.device.info import unknown_name
from eal_actors.device.localization.localizer import BY_HAND, UNKNOWN
from eal_actors.device.plugin_context import (
    PLUGIN_PACKAGE,
    EALPlugin,
    FactoryPlugin,
    FleetServices,
    OpenPlugins,
    PluginContext,
    PluginSettingsModel,
    ResourceFactory,
    crash_text,
)
from eal_actors.device.ports import BytePort
from eal_actors.device.resource import Resource
from eal_actors.device.world import WorldModel
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import ArgumentError, ConfigError, EALError, PluginError, Problem, error_text
from eal_actors.kernel.strict_model import model_of, wording_of
from eal_actors.managers.fleet_model import PluginSettings, RobotConfig
from eal_actors.managers.manifest import PluginManifest, discover, explain_unknown_plugin

_import_lock = threading.RLock()


def _renew_lock() -> None:
    global _import_lock
    _import_lock = threading.RLock()


if hasattr(os, "register_at_fork"):  # a child lacks the thread that holds the lock, while it imports for seconds
    os.register_at_fork(after_in_child=_renew_lock)


def import_plugin(manifest: PluginManifest) -> ModuleType:
    """Import a plugin's `plugin.py` in a package of its own, so that it can import its neighbours.

    The packages of the plugins that it uses are beside its own, so that it can import from them too. Raises PluginError
    if a module that it requires or a plugin that it uses is missing, or its code raised. Thread: any; one import at a
    time.
    """
    used = manifest.used()
    for plugin in (manifest, *used):
        if lack := plugin.lacks(manifest):
            raise PluginError(lack)
    path = manifest.folder / "plugin.py"
    if not path.is_file():
        raise PluginError(f"plugin {manifest.name!r} has no plugin.py in {manifest.folder}")
    with _import_lock:
        for plugin in used:
            package, plain = _package_for(plugin.folder.resolve(), plugin.name), f"{PLUGIN_PACKAGE}.{plugin.name}"
            if package != plain:
                raise PluginError(
                    f"plugin {manifest.name!r} uses the plugin {plugin.name!r} in {plugin.folder}, but another one of "
                    f"that name, in {sys.modules[plain].__path__[0]}, is loaded"
                )
        package = _package_for(manifest.folder.resolve(), manifest.name)
        try:
            return importlib.import_module(f"{package}.plugin")
        except (Exception, SystemExit) as error:
            raise PluginError(f"plugin {manifest.name!r} fails to import: {crash_text(error)}") from error


def _package_for(folder: Path, name: str) -> str:
    """Return the package name under which the folder is importable; another folder of that name gets its own."""
    root = sys.modules.setdefault(PLUGIN_PACKAGE, ModuleType(PLUGIN_PACKAGE))
    root.__path__ = []
    for package in (f"{PLUGIN_PACKAGE}.{name}", f"{PLUGIN_PACKAGE}.{name}_{zlib.crc32(str(folder).encode()):08x}"):
        if (module := sys.modules.get(package)) is None:
            module = sys.modules[package] = ModuleType(package)
            module.__path__ = [str(folder)]
        if list(module.__path__) == [str(folder)]:
            return package
    raise PluginError(f"plugin {name!r} cannot be distinguished from another plugin of that name")


@dataclass(frozen=True)
class PluginResource(ResourceFactory):
    """A resource of a connected plugin: creates and destroys it."""

    create_function: Callable[..., Any]
    destroy_function: Callable[..., Any]
    context: PluginContext

    @override
    def create(self) -> Resource:
        resource = _with_context(self.create_function, self.context)
        if not isinstance(resource, Resource):
            raise PluginError(f"{self.create_function.__name__} returned {resource!r}, which is no Resource")
        return resource

    @override
    def destroy(self, resource: Resource) -> None:
        self.destroy_function(resource)


@dataclass(frozen=True)
class ConnectedPlugins(OpenPlugins):
    """A robot's connected plugins."""

    resources: Mapping[str, PluginResource]
    errors: tuple[EALError, ...]
    _connected: tuple[tuple[str, ModuleType, EALPlugin], ...]

    @property
    @override
    def left_out(self) -> tuple[str, ...]:
        return tuple(reason for _, _, plugin in self._connected for reason in plugin.left_out)

    def close(self) -> None:
        """Disconnect every plugin; one that fails does not stop the others.

        Raises PluginError, which names the plugins that failed, and how.
        """
        failed = []
        for name, module, plugin in reversed(self._connected):
            try:
                module.disconnect(plugin)
            except (Exception, SystemExit, KeyboardInterrupt, GeneratorExit) as error:  # noqa: BLE001
                failed.append(f"{name}: {error_text(error)}")
        if failed:
            raise PluginError(f"disconnect failed in {'; '.join(failed)}")


class EALPluginManager:
    """Finds plugins by their manifests, and imports only what a robot names (Source: thesis §4.3.2).

    The given folders are searched before the bundled plugins and the installed packages. `errors` are those of plugins
    that could not be read.
    """

    def __init__(self, plugin_dirs: Iterable[Path] = ()) -> None:
        self.manifests, self.errors = discover(plugin_dirs)

    def check(self, robot: RobotConfig) -> tuple[list[Problem], list[PluginError]]:
        """Return the problems of a robot's plugins in the file, and the errors of those that do not import."""
        problems: list[Problem] = []
        broken: list[PluginError] = []
        for settings in robot.plugins.values():
            try:
                self._checked_settings(settings)
            except ConfigError as error:
                problems.extend(error.problems)
            except PluginError as error:
                broken.append(error.at(robot.name))
        return problems, broken

    def check_together(self, robots: Iterable[RobotConfig], world: WorldModel | None) -> list[Problem]:
        """Return the problems of settings that do not fit the fleet's world or one another.

        Settings that `check` refuses are left out. A robot with an address is checked alone: it may have a process, and
        so a simulated world, of its own.
        """
        processes: dict[tuple[str | None, type[PluginSettingsModel]], dict[str, tuple[PluginSettings, Any]]] = {}
        for robot in robots:
            for settings in robot.plugins.values():
                with suppress(ConfigError, PluginError):
                    if (checked := self._checked_settings(settings)[2]) is not None:
                        process = robot.name if robot.address is not None else None
                        processes.setdefault((process, type(checked)), {})[robot.name] = settings, checked
        problems = []
        for (_, model), found in processes.items():
            services = FleetServices(SystemClock(), world=world)
            refused = model.refused_in(services, {name: checked for name, (_, checked) in found.items()})
            problems += [
                found[name][0].problem((key,), why) for name, one in refused.items() for key, why in one.items()
            ]
        return problems

    def check_change(self, former: RobotConfig, robot: RobotConfig) -> list[Problem]:
        """Return the problems of a robot whose settings change while its fleet is open; both pass `check`."""
        problems: list[Problem] = []
        for instance, settings in robot.plugins.items():
            old = former.plugins.get(instance)
            if old is not None and old.plugin == settings.plugin:
                checked, before = self._checked_settings(settings)[2], self._checked_settings(old)[2]
                refused = {} if checked is None else checked.refused_changes(before)
                problems += [settings.problem((key,), message) for key, message in refused.items()]
        return problems

    def connect(self, robot: RobotConfig, services: FleetServices) -> ConnectedPlugins:
        """Connect a robot's plugins. One that fails leaves an error, and the others connect.

        Resources of the same name in two plugins are both renamed to `<instance>.<Resource>`, whatever the order in
        which they are found. Thread: the robot's actor; a plugin may block.
        """
        errors: list[EALError] = []
        connected: list[tuple[str, ModuleType, EALPlugin]] = []
        offers: list[tuple[str, str, PluginResource]] = []
        try:
            for settings in robot.plugins.values():
                _begin_pose(robot, settings.instance, services)
                try:
                    self._connect_one(robot.name, settings, services, connected, offers)
                except EALError as error:
                    errors.append(error.at(robot.name))
        except BaseException:  # interrupted: disconnect the connected ones
            ConnectedPlugins({}, (), tuple(connected)).close()
            raise
        return ConnectedPlugins(_with_unique_names(offers), tuple(errors), tuple(connected))

    def _connect_one(
        self,
        robot: str,
        settings: PluginSettings,
        services: FleetServices,
        connected: list[tuple[str, ModuleType, EALPlugin]],
        offers: list[tuple[str, str, PluginResource]],
    ) -> None:
        manifest, module, checked = self._checked_settings(settings)
        for function in ("connect", "disconnect"):
            if not callable(getattr(module, function, None)):
                raise PluginError(f"plugin {manifest.name!r} lacks the function {function}()")
        context = PluginContext(robot, settings.instance, checked, services)
        try:
            plugin = _with_context(module.connect, context)
        except PluginError as error:  # its message says what is wrong
            raise PluginError(f"plugin {manifest.name!r}: {error.message}") from error
        except (Exception, SystemExit, KeyboardInterrupt, GeneratorExit) as error:
            raise PluginError(f"plugin {manifest.name!r}: connect raised {crash_text(error)}") from error
        if not isinstance(plugin, EALPlugin):
            raise PluginError(f"plugin {manifest.name!r}: connect returned {plugin!r}, which is no EALPlugin")
        connected.append((settings.instance, module, plugin))  # from here on it must be disconnected
        promised, named = set(manifest.file.resources), set(plugin.list_resources())
        strays = named - promised if promised else set()
        if strays or (promised and named != promised and checked is None):  # settings may leave out some
            raise PluginError(
                f"plugin {manifest.name!r}: its manifest names {', '.join(sorted(promised))}, "
                f"but connect names {', '.join(sorted(named))}"
            )
        context = replace(context, plugin=plugin)
        offers += [(settings.instance, name, _resource_of(module, name, context)) for name in plugin.list_resources()]

    def open_port(self, context: PluginContext, url: str, model: str | None, emulate: Callable[[Any], Any]) -> BytePort:
        """Open a simulated port of the plugin that the URL's scheme names; see PluginContext.simulated_port.

        Raises PluginError if there is no such plugin, it makes no ports, or it refuses.
        """
        port: BytePort = self._simulator(url, "open_port")(context, url, model, emulate)
        return port

    def open_camera(self, context: PluginContext, url: str) -> Any:
        """Open a simulated camera of the plugin that the URL's scheme names; see PluginContext.simulated_camera.

        Raises PluginError if there is no such plugin, it makes no cameras, or it refuses.
        """
        return self._simulator(url, "open_camera")(context, url)

    def bridge(self, name: str, settings: Mapping[str, Any]) -> tuple[ModuleType, Any]:
        """Return a plugin's bridge, and its checked settings.

        The bridge is a module, whose `open_bridge(fleet, settings)` is a context manager that yields what it does; the
        settings are an instance of its `BridgeSettings`.

        Raises:
            ArgumentError: there is no such plugin, it brings no bridge, or the settings are wrong.
            PluginError: it does not import.
        """
        manifest = self.manifests.get(name)
        if manifest is None or manifest.file.bridge is None:
            bridges = [known for known, other in self.manifests.items() if other.file.bridge]
            raise ArgumentError(f"no plugin {name!r} brings a bridge; those that do: {', '.join(bridges) or 'none'}")
        package = import_plugin(manifest).__package__
        try:
            module = importlib.import_module(f"{package}.{manifest.file.bridge}")
            return module, module.BridgeSettings.model_validate(dict(settings))
        except ValidationError as error:
            wrong = "; ".join(f"{'.'.join(map(str, one['loc']))}: {wording_of(one)}" for one in error.errors())
            raise ArgumentError(f"bridge {name!r}: {wrong}") from None
        except Exception as error:
            raise PluginError(f"plugin {name!r}: its bridge fails to import: {crash_text(error)}") from error

    def _simulator(self, url: str, function: str) -> Callable[..., Any]:
        scheme, what = url.partition("://")[0], function.removeprefix("open_")
        found = (one for one in self.manifests.values() if (made := one.file.simulation) and made.scheme == scheme)
        if (manifest := next(found, self.manifests.get(scheme))) is None:
            raise PluginError(f"{what} {url!r}: {unknown_name('plugin', scheme, self.manifests)}")
        maker: Callable[..., Any] | None = getattr(import_plugin(manifest), function, None)
        if not callable(maker):
            raise PluginError(f"{what} {url!r}: the plugin {manifest.name!r} makes no simulated {what}s")
        return maker

    def _checked_settings(self, settings: PluginSettings) -> tuple[PluginManifest, ModuleType, Any]:
        if (manifest := self.manifests.get(settings.plugin)) is None:
            raise ConfigError(
                [settings.problem((), explain_unknown_plugin(settings.plugin, self.manifests, self.errors))]
            )
        module = import_plugin(manifest)
        if (model := getattr(module, "Settings", None)) is None:
            if settings.settings:
                raise ConfigError(
                    [settings.problem((key,), f"plugin {manifest.name!r} has no settings") for key in settings.settings]
                )
            return manifest, module, None
        if not (isinstance(model, type) and issubclass(model, PluginSettingsModel)):
            raise PluginError(f"plugin {manifest.name!r}: Settings must extend PluginSettingsModel")
        try:
            return manifest, module, model_of(model, settings.tree)
        except ConfigError:
            raise
        except Exception as error:
            raise PluginError(f"plugin {manifest.name!r}: its Settings raised {crash_text(error)}") from error


def _begin_pose(robot: RobotConfig, instance: str, services: FleetServices) -> None:
    """Set where the pose estimate of a driver begins, as far as the fleet file tells."""
    start, localizer = robot.pose.start, services.localizer(robot.name, instance)
    if start is not None:
        localizer.begin_at(float(start.x_m), float(start.y_m), math.radians(start.yaw_deg), BY_HAND, is_given=True)
    elif robot.pose.trackers:
        localizer.begin_at(0.0, 0.0, 0.0, UNKNOWN)


def _with_context(function: Callable[..., Any], context: PluginContext) -> Any:
    """Call a plugin's function, with the context if it takes one."""
    return function(context) if inspect.signature(function).parameters else function()


def _resource_of(module: ModuleType, name: str, context: PluginContext) -> PluginResource:
    if isinstance(context.plugin, FactoryPlugin):
        return _made_by(context.plugin.makers[name], context)
    functions = []
    for function in (f"create_{name}", f"destroy_{name}"):
        found = getattr(module, function, getattr(module, function.replace("_", "", 1), None))  # the thesis's name too
        if not callable(found):
            raise PluginError(
                f"plugin {context.instance!r} names the resource {name!r}, but lacks the function {function}()"
            )
        functions.append(found)
    return PluginResource(functions[0], functions[1], context)


def _made_by(make: Callable[[], Resource], context: PluginContext) -> PluginResource:
    def create() -> Resource:
        return make()

    def destroy(resource: Resource) -> None:
        """Do nothing: `disconnect` frees what the resources share."""

    return PluginResource(create, destroy, context)


def _with_unique_names(offers: list[tuple[str, str, PluginResource]]) -> dict[str, PluginResource]:
    names = [name for _, name, _ in offers]
    return {f"{instance}.{name}" if names.count(name) > 1 else name: resource for instance, name, resource in offers}
