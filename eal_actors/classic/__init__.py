"""The thesis's names and return conventions, so that its programs and plugins can be ported call by call.

`EALconnect` returns an EAL or None. Calls that return data return an EALDataInfo_t or None. Calls that return a status
return an int, -1 for "not found" and for every failure, which is logged with its reason. New programs should use
`eal_actors.connect` or `Fleet`, which raise errors.

Source: thesis §4.4, appendix B.
"""

from eal_actors.classic.connection import EAL, EALconnect, EALdisconnect, EALResourceId_t
from eal_actors.classic.data import (
    ACTUATOR,
    BOOL,
    CHAR,
    COMMUNICATION,
    DOUBLE,
    FLOAT,
    INT,
    ISLONG,
    ISPTR,
    ISSHORT,
    ISUNSIGNED,
    OTHER,
    SENSOR,
    VOID,
    EALData_t,
    EALDataInfo_t,
    EALDataType_t,
    EALResourceInfo_t,
)
from eal_actors.classic.resource import EALBaseResource, EALResource
from eal_actors.device.plugin_context import EALPlugin

__all__ = [
    "ACTUATOR",
    "BOOL",
    "CHAR",
    "COMMUNICATION",
    "DOUBLE",
    "EAL",
    "FLOAT",
    "INT",
    "ISLONG",
    "ISPTR",
    "ISSHORT",
    "ISUNSIGNED",
    "OTHER",
    "SENSOR",
    "VOID",
    "EALBaseResource",
    "EALDataInfo_t",
    "EALDataType_t",
    "EALData_t",
    "EALPlugin",
    "EALResource",
    "EALResourceId_t",
    "EALResourceInfo_t",
    "EALconnect",
    "EALdisconnect",
]
