"""The factsheet of a robot of the fleet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from eal_actors import EALError, RobotHandle

from .messages import AgvHeader

ACTIONS: Final = ("command",)
"""The actions of nodes: `command` sends a command to a resource of the robot."""
_INSTANT: Final = ("cancelOrder", "startPause", "stopPause", "stateRequest", "factsheetRequest", "initPosition")
_OPTIONAL: Final = (
    "order.nodes.nodePosition.theta",
    "order.nodes.nodePosition.allowedDeviationXY",
    "order.edges.maxSpeed",
)
_KNOWN_S: Final = 5.0


class FactsheetMessage(AgvHeader):
    """A factsheet; its parts are as the standard has them."""

    type_specification: dict[str, Any]
    physical_parameters: dict[str, Any]
    protocol_limits: dict[str, Any]
    protocol_features: dict[str, Any]
    agv_geometry: dict[str, Any]
    load_specification: dict[str, Any]


def factsheet(header: Mapping[str, Any], robot: RobotHandle) -> FactsheetMessage:
    """Return the factsheet of a robot, by what its base says of itself."""
    base = robot["Base"]
    speeds = [one.value.maximum for one in base.info.configs if one.name == "speed_m_s"]
    try:
        diameter_m = 2.0 * float(base.get_config("radius_m", timeout_s=_KNOWN_S).get().value)
    except EALError:  # a base without one
        diameter_m = 0.0
    parameters = [
        {"key": "resource", "valueDataType": "STRING", "description": "Name of a resource of the robot."},
        {"key": "command", "valueDataType": "STRING", "description": "Text of a command of the resource."},
    ]
    return FactsheetMessage(
        **header,
        type_specification={
            "seriesName": robot.name,
            "agvKinematic": "DIFF",
            "agvClass": "CARRIER",
            "maxLoadMass": 0,
            "localizationTypes": ["NATURAL"],
            "navigationTypes": ["AUTONOMOUS"],
        },
        physical_parameters={
            "speedMin": 0.01,
            "speedMax": speeds[0] if speeds and speeds[0] is not None else 0.0,
            "accelerationMax": 0.4,
            "decelerationMax": 0.4,
            "heightMax": 0.0,
            "width": diameter_m,
            "length": diameter_m,
        },
        protocol_limits={
            "maxStringLens": {},
            "maxArrayLens": {},
            "timing": {"minOrderInterval": 0.1, "minStateInterval": 0.02, "defaultStateInterval": 1.0},
        },
        protocol_features={
            "optionalParameters": [
                {"parameter": "order.nodes.nodePosition", "support": "REQUIRED"},
                *({"parameter": name, "support": "SUPPORTED"} for name in _OPTIONAL),
            ],
            "agvActions": [
                *({"actionType": name, "actionScopes": ["NODE"], "actionParameters": parameters} for name in ACTIONS),
                *({"actionType": name, "actionScopes": ["INSTANT"]} for name in _INSTANT),
            ],
        },
        agv_geometry={},
        load_specification={},
    )
