"""The objects that a plugin returns to the framework and receives from it, and their factories."""

from __future__ import annotations

import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self, TypeAlias, TypeVar

from eal_actors.device.link import FaultyLink
from eal_actors.device.localization.localizer import Localizer
from eal_actors.device.picture_log import PictureLog
from eal_actors.device.ports import BytePort
from eal_actors.device.proximity import Contact, ProximityObserver
from eal_actors.device.resource import Resource
from eal_actors.device.world import WorldModel
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, PluginError, error_text
from eal_actors.kernel.strict_model import StrictModel

_T = TypeVar("_T")

PLUGIN_PACKAGE: Final = "eal_plugins"
"""The package that contains every plugin's package."""


def crash_text(error: BaseException) -> str:
    """Return an exception as `Type: message`, with the line of a plugin that it came through last.

    An OSError is shown without a line: a device caused it, not the plugin's code.
    """
    lines = [
        f"{'/'.join(Path(frame.f_code.co_filename).parts[-2:])}:{line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__")).startswith(f"{PLUGIN_PACKAGE}.")
    ]
    return f"{error_text(error)} (at {lines[-1]})" if lines and not isinstance(error, OSError) else error_text(error)


class PluginSettingsModel(StrictModel):
    """The base of a plugin's `Settings`: strict types, no unknown keys, immutable."""

    def refused_changes(self, former: Self) -> Mapping[str, str]:  # noqa: ARG002  # to be overridden
        """Return why these settings cannot replace the former ones while the fleet is open, by their keys.

        The default refuses none: the plugin is disconnected and connected with the new settings.
        """
        return {}

    @classmethod
    def refused_in(
        cls,
        services: FleetServices,  # noqa: ARG003  # to be overridden
        robots: Mapping[str, Self],  # noqa: ARG003
    ) -> Mapping[str, Mapping[str, str]]:
        """Return why settings do not fit the fleet's world or one another, by robot and key; `eal check` reports it.

        Args:
            services: those of a fleet that is only checked, with its `world`.
            robots: the settings of this plugin, by the robots of one process.
        """
        return {}


class EALPlugin:
    """The result of `connect`: the names of the plugin's resources (Source: thesis B.3.2).

    Either `EALPlugin("A", "B")`, which a None may end as in the thesis, or with the count first, `EALPlugin(2, "A",
    "B")`, where names beyond the count are ignored and too few are an error. Subclass it to hold objects that the
    resources share, such as an open port. Raises PluginError for no name, a name twice, or fewer names than the count.
    """

    left_out: tuple[str, ...] = ()
    """Why resources that the robot could have are missing; the error about an unknown resource contains it."""

    def __init__(self, *names: str | int | None) -> None:
        named = names[: names.index(None)] if None in names else names
        count = len(named)
        if named and isinstance(named[0], int):
            count, named = named[0], named[1:]
            if count > len(named):
                raise PluginError(f"EALPlugin was promised {count} resources, but only {len(named)} are named")
        resources = [str(name) for name in named[:count]]
        if not resources:
            raise PluginError("EALPlugin names no resource")
        if twice := sorted({name for name in resources if resources.count(name) > 1}):
            raise PluginError(f"EALPlugin names {', '.join(twice)} twice")
        self._resources = tuple(resources)

    def list_resources(self) -> tuple[str, ...]:
        """Return the resources' names (Source: thesis §4.2.2.1, listResources)."""
        try:
            return self._resources
        except AttributeError:
            raise PluginError(
                f"{type(self).__name__} does not call super().__init__ with its resources' names"
            ) from None


class FactoryPlugin(EALPlugin):
    """A plugin that makes its resources by functions; its module has no `create_` and `destroy_` for them.

    For plugins whose settings name the resources, or whose resources all share one connection. `disconnect` frees what
    they share.
    """

    def __init__(self, makers: Mapping[str, Callable[[], Resource]], left_out: tuple[str, ...] = ()) -> None:
        super().__init__(*makers)
        self.makers = makers
        self.left_out = left_out


PortMaker: TypeAlias = "Callable[[PluginContext, str, str | None, Callable[[Any], Any]], BytePort]"
"""Opens a simulated port: the `open_port` of a plugin such as sim; see PluginContext.simulated_port."""

CameraMaker: TypeAlias = "Callable[[PluginContext, str], Any]"
"""Opens a simulated camera: the `open_camera` of a plugin such as sim; see PluginContext.simulated_camera."""


@dataclass(eq=False)
class FleetServices:
    """The shared objects of one fleet's plugins: its clock, its world, and single objects such as a simulation.

    Attributes:
        seed: the fleet's seed; every random generator of a plugin must derive from it.
        open_port: opens simulated ports; None if there are none.
        open_camera: opens simulated cameras; None if there are none.
        proximity_observer: receives the gaps around simulated robots; set it before the robots connect.
        solid_robots: simulated robots touch and sense each other; set it before the robots connect.
        contacts: the contacts of simulated robots; a simulation appends to it, in any thread.
        picture_log: receives what is found in pictures of simulated cameras, and knows that of a past; None if nobody
            records it.
        markers: the id of the marker that each robot carries, by the robot's name.
    """

    clock: Clock
    seed: int = 0
    world: WorldModel | None = None
    open_port: PortMaker | None = None
    open_camera: CameraMaker | None = None
    markers: Mapping[str, int] = field(default_factory=dict, init=False)
    proximity_observer: ProximityObserver | None = field(default=None, init=False)
    solid_robots: bool = field(default=True, init=False)
    contacts: Final[list[Contact]] = field(default_factory=list, init=False)
    picture_log: PictureLog | None = field(default=None, init=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, init=False)
    _shared: dict[Hashable, Any] = field(default_factory=dict, init=False)

    def link(self, robot: str) -> FaultyLink:
        """Return the link to a robot, for plugins that inject faults. Thread: any."""
        return self.shared(("link", robot), lambda: FaultyLink(robot, self.seed))

    def localizer(self, robot: str, instance: str) -> Localizer:
        """Return the pose estimate of a driver; it outlives restarts of the robot and its plugins. Thread: any."""
        return self.shared(("localizer", robot, instance), lambda: Localizer(robot))

    def shared(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return the fleet's single object under the key; the first caller makes it. Thread: any."""
        with self._lock:
            if key not in self._shared:
                self._shared[key] = make()
            found: _T = self._shared[key]
            return found


@dataclass(frozen=True)
class PluginContext:
    """The environment of a plugin.

    Attributes:
        instance: the plugin's instance name on that robot.
        settings: the plugin's checked `Settings`, or None if it has no such class.
        plugin: the result of `connect`; None while `connect` itself runs.
    """

    robot: str
    instance: str
    settings: Any
    services: FleetServices
    plugin: Any = field(default=None)

    @property
    def clock(self) -> Clock:
        """The fleet's clock."""
        return self.services.clock

    @property
    def localizer(self) -> Localizer:
        """The pose estimate of the robot whose wheels this plugin drives; closed-loop motion reads it."""
        return self.services.localizer(self.robot, self.instance)

    def simulated_port(self, url: str, model: str | None, emulate: Callable[[Any], Any]) -> BytePort:
        """Open a port to an emulator whose body is a robot of a simulated world.

        Args:
            url: `<plugin>://...`, where the plugin is the one that simulates, such as `sim://world/roomba-1`.
            model: the required model of the robot, as that plugin names it; None, for sensors, for any model.
            emulate: makes the driver's emulator for a body: an object with `feed(data, now_s) -> bytes`.

        Raises PluginError if there is no such plugin or robot, or it opens no ports.
        """
        if self.services.open_port is None:
            raise PluginError(f"port {url!r}: there are no simulated ports here")
        return self.services.open_port(self, url, model, emulate)

    def simulated_camera(self, url: str) -> Any:
        """Open a camera of a simulated world.

        `url` is `<plugin>://world/<camera>`, where the plugin is the one that simulates, such as `sim://world/ceiling`.
        The camera's `frame() -> (picture, stamp_s)` returns blue, green and red, shape (height, width, 3), and the time
        of its exposure, in any thread. Raises PluginError if there is no such plugin or camera.
        """
        if self.services.open_camera is None:
            raise PluginError(f"camera {url!r}: there are no simulated cameras here")
        return self.services.open_camera(self, url)


class ResourceFactory(ABC):
    """Makes and destroys one resource of a plugin. Thread: the resource's actor."""

    @abstractmethod
    def create(self) -> Resource:
        """Return a new resource."""

    @abstractmethod
    def destroy(self, resource: Resource) -> None:
        """Destroy the resource."""


class OpenPlugins(ABC):
    """A robot's connected plugins."""

    resources: Mapping[str, ResourceFactory]
    errors: tuple[EALError, ...]

    @property
    def left_out(self) -> tuple[str, ...]:
        """Why the connected plugins lack resources; see EALPlugin."""
        return ()

    @abstractmethod
    def close(self) -> None:
        """Disconnect every plugin."""
