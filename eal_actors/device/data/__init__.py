"""EALData: the one kind of value that crosses the framework."""

from eal_actors.device.data.c_types import DataType
from eal_actors.device.data.storage import Payload
from eal_actors.device.data.value import EALData

__all__ = ["DataType", "EALData", "Payload"]
