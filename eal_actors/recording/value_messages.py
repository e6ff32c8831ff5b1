"""The schema and message of any sampled value, for files and live viewers; and what they need to know of the robots."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.device.data.images import encode_image
from eal_actors.device.info import ResourceInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.recording import messages, schemas
from eal_actors.recording.messages import Message
from eal_actors.recording.sampler import SampleSpec
from eal_actors.recording.schemas import MessageSchema

_ANGLES: Final = "angles"
"""The request for the directions of a scanner's rays."""
_BASE: Final = "Base"
_RADIUS: Final = "radius_m"

Infos = Mapping[str, Mapping[str, ResourceInfo]]
"""The information of resources, by robot and name."""


def topic_of(resource: ResourceHandle) -> str:
    """Return the topic of a resource's values."""
    return f"/{resource.robot}/{resource.name}"


def message_of(
    resource: ResourceHandle, data: EALData, time_s: float, angles_rad: Sequence[float] | None
) -> tuple[MessageSchema, Message]:
    """Return the message of a value: an image, a scan, or JSON; raise EALError if an image cannot be encoded."""
    frame_id = data.frame_id or messages.base_frame(resource.robot)
    if data.dtype == "|u1" and data.shape is not None and data.shape[2:] == (3,):
        return schemas.IMAGE, messages.image_message(time_s, frame_id, encode_image(data, "jpeg"))
    if angles_rad and data.shape == (len(angles_rad),):
        return schemas.SCAN, messages.scan_message(time_s, frame_id, data.value.tolist(), angles_rad)
    return schemas.VALUE, messages.value_message(time_s, data)


def resource_infos(fleet: Fleet, robots: Iterable[str]) -> Infos:
    """Return the information of every resource that gives it; the others are logged."""
    found: dict[str, dict[str, ResourceInfo]] = {}
    for robot in robots:
        found[robot] = {}
        for name, resource in fleet[robot].items():
            try:
                found[robot][name] = resource.info
            except EALError as error:
                get_logger(robot=robot).warning("a resource is not recorded", resource=name, reason=error.message)
    return found


def scanner_angles(infos: Infos, specs: Iterable[SampleSpec]) -> dict[str, list[float]]:
    """Return the directions of each scanner's rays, by its topic. Thread: waits for the answers."""
    asked = {
        topic_of(resource): resource.send_req(_ANGLES)
        for resource, _ in specs
        if any(request.name == _ANGLES for request in infos[resource.robot][resource.name].requests)
    }
    found = {}
    for topic, answer in asked.items():
        try:
            found[topic] = [float(angle_rad) for angle_rad in answer.get().value]
        except (EALError, TypeError, ValueError) as error:  # the robot may send anything
            get_logger().warning("the angles of a scanner are unknown", topic=topic, reason=error_text(error))
    return found


def hull_radii_m(fleet: Fleet, infos: Infos) -> dict[str, float]:
    """Return the radius of each robot whose base tells it. Thread: waits for the answers."""
    asked = {
        robot: fleet[robot][_BASE].get_config(_RADIUS)
        for robot, found in infos.items()
        if _BASE in found and any(config.name == _RADIUS for config in found[_BASE].configs)
    }
    radii_m = {}
    for robot, answer in asked.items():
        try:
            radii_m[robot] = float(answer.get().value)
        except (EALError, TypeError, ValueError) as error:
            get_logger(robot=robot).debug("the robot's radius is unknown", reason=error_text(error))
    return radii_m
