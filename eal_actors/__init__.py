"""EAL actors: one scenario, one controller, across a fleet of different robots.

Three ways in: `eal run SCENARIO --fleet FLEET`, the synchronous `connect()`, and the concurrent `Fleet`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from eal_actors.actors.combine import as_completed, first, gather
    from eal_actors.actors.future import Future
    from eal_actors.actors.handles import ResourceHandle, RobotHandle
    from eal_actors.device.data import DataType, EALData
    from eal_actors.device.info import ResourceInfo, ResourceType
    from eal_actors.device.localization.pose_estimate import PoseEstimate
    from eal_actors.facade.eal import EAL, connect
    from eal_actors.facade.fleet import Fleet
    from eal_actors.kernel.errors import BlockedError, EALError, LocalizationError

__version__ = "0.1.0"

__all__ = [
    "EAL",
    "BlockedError",
    "DataType",
    "EALData",
    "EALError",
    "Fleet",
    "Future",
    "LocalizationError",
    "PoseEstimate",
    "ResourceHandle",
    "ResourceInfo",
    "ResourceType",
    "RobotHandle",
    "as_completed",
    "connect",
    "first",
    "gather",
]

_HOMES: Final = {
    "BlockedError": "eal_actors.kernel.errors",
    "DataType": "eal_actors.device.data",
    "EAL": "eal_actors.facade.eal",
    "EALData": "eal_actors.device.data",
    "EALError": "eal_actors.kernel.errors",
    "Fleet": "eal_actors.facade.fleet",
    "Future": "eal_actors.actors.future",
    "LocalizationError": "eal_actors.kernel.errors",
    "PoseEstimate": "eal_actors.device.localization.pose_estimate",
    "ResourceHandle": "eal_actors.actors.handles",
    "ResourceInfo": "eal_actors.device.info",
    "ResourceType": "eal_actors.device.info",
    "RobotHandle": "eal_actors.actors.handles",
    "as_completed": "eal_actors.actors.combine",
    "connect": "eal_actors.facade.eal",
    "first": "eal_actors.actors.combine",
    "gather": "eal_actors.actors.combine",
}


def __getattr__(name: str) -> Any:
    """Import a name when it is first used, so that one part of the framework costs no more than it needs."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value
