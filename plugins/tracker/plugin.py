"""The tracker plugin: cameras above the floor that find the robots by their markers."""

# ruff: noqa: N802  # the plugin API requires names such as create_Fixes

from __future__ import annotations

from eal_actors.plugin import FAMILIES, EALPlugin, FamilyName, PluginContext, PluginError, Resource

from .feeds import open_feed
from .floor import FloorPicture
from .resources import FixesSensor, TrackedPicture
from .settings import Settings
from .tracker import Tracker

__all__ = ["Settings", "TrackerPlugin", "connect", "disconnect"]


class TrackerPlugin(EALPlugin):
    """A plugin with one tracker."""

    def __init__(self, tracker: Tracker, *, has_floor: bool) -> None:
        super().__init__("Fixes", "Picture", *(["Floor"] if has_floor else []))
        self.tracker = tracker


def connect(context: PluginContext) -> TrackerPlugin:
    """Open the cameras.

    Raises:
        PluginError: a camera's file or simulated camera is missing, or the family has no such marker.
    """
    settings: Settings = context.settings
    world = context.services.world
    family: FamilyName = settings.family or (world.markers.family if world is not None else "4x4_50")
    floor = settings.floor if settings.floor is not None else world.markers.floor if world is not None else ()
    _check_ids(settings, family, [marker.id for marker in floor])
    tracker = Tracker(context.robot, family, settings.markers, floor, set(context.services.markers.values()))
    try:
        for name, camera in settings.cameras.items():
            tracker.add_camera(name, camera.lens.lens(), open_feed(context, name, camera, is_drawn=settings.drawn))
    except BaseException:
        tracker.close()
        raise
    return TrackerPlugin(tracker, has_floor=world is not None)


def _check_ids(settings: Settings, family: FamilyName, floor: list[int]) -> None:
    worn = [number for group in settings.markers for number in group.ids]
    if both := sorted(set(worn) & set(floor)):
        raise PluginError(f"markers {', '.join(map(str, both))} are on robots and on the floor: give each id one place")
    last = FAMILIES[family].count - 1
    if beyond := sorted(number for number in (*worn, *floor) if number > last):
        raise PluginError(f"markers {', '.join(map(str, beyond))}: the family {family} ends with {last}")


def disconnect(plugin: TrackerPlugin) -> None:
    """Close the cameras."""
    plugin.tracker.close()


def create_Fixes(context: PluginContext) -> FixesSensor:
    """Create the robots' poses."""
    return FixesSensor(context.plugin.tracker, context.clock)


def create_Picture(context: PluginContext) -> TrackedPicture:
    """Create the pictures with the found markers."""
    return TrackedPicture(context.plugin.tracker, context.robot)


def create_Floor(context: PluginContext) -> FloorPicture:
    """Create the picture of the whole floor."""
    world = context.services.world
    if world is None:
        raise PluginError("the fleet has no world, whose size the picture of the floor needs")
    return FloorPicture(context.plugin.tracker, world.size_m)


def destroy_Fixes(resource: Resource) -> None:
    """Do nothing: `disconnect` closes the cameras."""


def destroy_Picture(resource: Resource) -> None:
    """Do nothing: `disconnect` closes the cameras."""


def destroy_Floor(resource: Resource) -> None:
    """Do nothing: `disconnect` closes the cameras."""
