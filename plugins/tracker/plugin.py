"""The tracker plugin: cameras above the floor that find the robots by their markers."""

from __future__ import annotations

from eal_actors.plugin import FAMILIES, FactoryPlugin, FamilyName, PluginContext, PluginError

from .feeds import open_feed
from .floor import FloorPicture
from .resources import FixesSensor, TrackedPicture
from .settings import Settings
from .tracker import Tracker

__all__ = ["Settings", "TrackerPlugin", "connect", "disconnect"]


class TrackerPlugin(FactoryPlugin):
    """A plugin with one tracker; it has a picture of the floor if the fleet has a world, which tells its size."""

    def __init__(self, context: PluginContext, tracker: Tracker) -> None:
        world = context.services.world
        floor = {} if world is None else {"Floor": lambda: FloorPicture(tracker, world.size_m)}
        super().__init__(
            {
                "Fixes": lambda: FixesSensor(tracker, context.clock),
                "Picture": lambda: TrackedPicture(tracker, context.robot),
                **floor,
            }
        )
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
    return TrackerPlugin(context, tracker)


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
