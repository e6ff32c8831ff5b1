"""EAL actors: one scenario, one controller, across a fleet of different robots.

Three ways in: `eal run SCENARIO --fleet FLEET`, the synchronous `connect()`, and the concurrent `Fleet`.
"""

from eal_actors.actors.combine import as_completed, first, gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.data import DataType, EALData
from eal_actors.errors import EALError
from eal_actors.facade.eal import EAL, connect
from eal_actors.facade.fleet import Fleet
from eal_actors.info import ResourceInfo, ResourceType

__version__ = "0.1.0"

__all__ = [
    "EAL",
    "DataType",
    "EALData",
    "EALError",
    "Fleet",
    "Future",
    "ResourceHandle",
    "ResourceInfo",
    "ResourceType",
    "RobotHandle",
    "as_completed",
    "connect",
    "first",
    "gather",
]
