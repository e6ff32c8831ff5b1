"""Messages of `run.mcap`, as plain data: poses, values, images, arenas and calls in the form of `schemas`."""

from __future__ import annotations

import base64
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, TypeAlias

from eal_actors.device.data import EALData
from eal_actors.device.world import BoxObstacle, Drop, MovableBox, WorldModel
from eal_actors.recording.poses import PoseSample
from eal_actors.recording.schemas import UNUSED_SHAPES

Message: TypeAlias = dict[str, Any]

WORLD_FRAME: Final = "world"
MODIFIERS: Final = ("is_ptr", "is_unsigned", "is_short", "is_long")
_NS: Final = 1_000_000_000
_STILL: Final[Message] = {"x": 0.0, "y": 0.0, "z": 0.0}
_LEVELS: Final = {"debug": 1, "info": 2, "warning": 3, "error": 4}
_GREY: Final = (0.72, 0.72, 0.72, 1.0)
_WOOD: Final = (0.86, 0.74, 0.52, 1.0)
_HOLE: Final = (0.08, 0.08, 0.08, 1.0)
_INK: Final = (0.1, 0.1, 0.1, 1.0)
_FLOOR_M: Final = 0.005
_LABEL_M: Final = 0.15
_HULL_M: Final = 0.1
_HULLS: Final = ((0.0, 0.45, 0.7, 0.8), (0.84, 0.37, 0.0, 0.8), (0.0, 0.62, 0.45, 0.8), (0.8, 0.47, 0.65, 0.8))
"""The colours of robots, those of the pictures of runs."""
FARTHEST_M: Final = sys.float_info.max
"""An infinite range, for which JSON has no number."""


def nanoseconds(time_s: float) -> int:
    """Return a time in whole nanoseconds, at least 0."""
    return max(0, round(time_s * _NS))


def base_frame(robot: str) -> str:
    """Return the name of a robot's own frame: x ahead, y to the left, z up, the origin between its wheels."""
    return f"{robot}/base"


def _stamp(time_s: float) -> Message:
    sec, nsec = divmod(nanoseconds(time_s), _NS)
    return {"sec": sec, "nsec": nsec}


def shifted(message: Message, by_ns: int) -> Message:
    """Return a message with its times moved, also those of the transforms and entities in it."""
    if not by_ns:
        return message
    moved = dict(message)
    if "timestamp" in message:
        stamp = message["timestamp"]
        sec, nsec = divmod(stamp["sec"] * _NS + stamp["nsec"] + by_ns, _NS)
        moved["timestamp"] = {"sec": sec, "nsec": nsec}
    for part in ("transforms", "entities"):
        if part in message:
            moved[part] = [shifted(item, by_ns) for item in message[part]]
    return moved


def stamped(time_s: float) -> Message:
    """Return the part of a message that has its time."""
    return {"timestamp": _stamp(time_s)}


def seconds(message: Message) -> float:
    """Return the time of a message, in seconds since the run's start."""
    stamp = message["timestamp"]
    return float(stamp["sec"]) + float(stamp["nsec"]) / _NS


def _vector(x: float, y: float, z: float = 0.0) -> Message:
    return {"x": x, "y": y, "z": z}


def _turn(yaw_rad: float) -> Message:
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw_rad / 2), "w": math.cos(yaw_rad / 2)}


def yaw_of(turn: Message) -> float:
    """Return the heading of an orientation about the z axis, in rad from -pi to pi."""
    return math.remainder(2 * math.atan2(turn["z"], turn["w"]), 2 * math.pi)


def _pose(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> Message:
    return {"position": _vector(x_m, y_m, z_m), "orientation": _turn(yaw_rad)}


def _colour(rgba: Sequence[float]) -> Message:
    return dict(zip("rgba", rgba, strict=True))


def pose_message(sample: PoseSample) -> Message:
    """Return a PoseInFrame in the world frame."""
    pose = _pose(sample.x_m, sample.y_m, yaw_rad=sample.yaw_rad)
    return {"timestamp": _stamp(sample.time_s), "frame_id": WORLD_FRAME, "pose": pose}


def poses_message(time_s: float, numbers: Sequence[float]) -> Message:
    """Return a PosesInFrame in the world frame of x_m, y_m, yaw_rad of each pose."""
    each = iter(numbers)
    poses = [_pose(x_m, y_m, yaw_rad=yaw_rad) for x_m, y_m, yaw_rad in zip(each, each, each, strict=True)]
    return {"timestamp": _stamp(time_s), "frame_id": WORLD_FRAME, "poses": poses}


def transform_message(robot: str, sample: PoseSample) -> Message:
    """Return a FrameTransforms from the world to the robot's own frame."""
    return {"transforms": [transform_of(robot, sample)]}


def transform_of(robot: str, sample: PoseSample) -> Message:
    """Return the transform from the world to the robot's own frame."""
    return {
        "timestamp": _stamp(sample.time_s),
        "parent_frame_id": WORLD_FRAME,
        "child_frame_id": base_frame(robot),
        "translation": _vector(sample.x_m, sample.y_m),
        "rotation": _turn(sample.yaw_rad),
    }


def image_message(time_s: float, frame_id: str, file: bytes) -> Message:
    """Return a CompressedImage of a JPEG file."""
    data = base64.b64encode(file).decode("ascii")
    return {"timestamp": _stamp(time_s), "frame_id": frame_id, "data": data, "format": "jpeg"}


def scan_message(time_s: float, frame_id: str, ranges_m: Sequence[float], angles_rad: Sequence[float]) -> Message:
    """Return a LaserScan; its rays are evenly spread, counter-clockwise.

    The schema requires numbers: an infinite range becomes FARTHEST_M, and `invalid` lists the ranges that are NaN.
    """
    numbers = [float(range_m) for range_m in ranges_m]
    return {
        "timestamp": _stamp(time_s),
        "frame_id": frame_id,
        "pose": {"position": _STILL, "orientation": _turn(0.0)},
        "start_angle": float(angles_rad[0]),
        "end_angle": float(angles_rad[-1]),
        "ranges": [
            FARTHEST_M if math.isnan(number) else max(-FARTHEST_M, min(number, FARTHEST_M)) for number in numbers
        ],
        "intensities": [],
        "invalid": [index for index, number in enumerate(numbers) if math.isnan(number)],
    }


def ranges_of(message: Message) -> list[float]:
    """Return the ranges of a LaserScan in m, with infinities and NaN restored."""
    ends = {FARTHEST_M: math.inf, -FARTHEST_M: -math.inf}
    found = [ends.get(range_m, range_m) for range_m in message["ranges"]]
    for index in message["invalid"]:
        found[index] = math.nan
    return found


def value_message(time_s: float, data: EALData) -> Message:
    """Return any value as JSON (bytes in base 64), with its type, so that it can be read back."""
    plain = data.value
    if isinstance(plain, bytes):
        plain = base64.b64encode(plain).decode("ascii")
    elif data.dtype is not None:
        plain = plain.tolist()
    modifiers = [name for name in MODIFIERS if getattr(data, name)]
    return {
        "timestamp": _stamp(time_s),
        "frame_id": data.frame_id or "",
        "type": data.type.value,
        "modifiers": modifiers,
        "unit": data.unit or "",
        "dtype": data.dtype or "",
        "shape": list(data.shape or ()),
        "value": plain,
    }


def log_message(time_s: float, level: str, name: str, text: str) -> Message:
    """Return a Log line; `name` is the robot's."""
    return {"timestamp": _stamp(time_s), "level": _LEVELS[level], "message": text, "name": name, "file": "", "line": 0}


def command_message(record: Mapping[str, Any]) -> Message:
    """Return a Command of a step that was a call, as `summary.json` has it."""
    return {
        **stamped(record["start_s"]),
        "resource": record["resource"],
        "method": record["kind"],
        "command": record["command"] or "",
        "step": record["step"],
        "outcome": record["outcome"],
        "duration_s": record["end_s"] - record["start_s"],
        "error": record["error"]["message"] if record["error"] is not None else "",
    }


def scene_message(world: WorldModel) -> Message:
    """Return a SceneUpdate of an arena at its start: walls, obstacles, boxes, beacons and drops."""
    boxes = [part for part in world.solid_obstacles if isinstance(part, BoxObstacle)]
    cubes = [*_walls(world), *(_cube(box, box.height_m, _GREY) for box in boxes)]
    cubes += [_cube(box, box.height_m, _WOOD) for box in world.boxes]
    cubes += [_cube(drop, _FLOOR_M, _HOLE) for drop in world.drops]
    pillars = [part for part in world.solid_obstacles if not isinstance(part, BoxObstacle)]
    cylinders = [_cylinder(part.x_m, part.y_m, part.radius_m, part.height_m, _GREY) for part in pillars]
    for beacon in world.beacons:
        colour = (*(channel / 255 for channel in beacon.colour), 1.0)
        cylinders.append(_cylinder(beacon.x_m, beacon.y_m, beacon.radius_m, beacon.height_m, colour))
    texts = [_label(beacon.x_m, beacon.y_m, beacon.height_m, beacon.name) for beacon in world.beacons]
    return {"deletions": [], "entities": [_entity(world.name, WORLD_FRAME, cubes, cylinders, texts)]}


def hull_message(radius_m: Mapping[str, float]) -> Message:
    """Return a SceneUpdate of robots by name: a disc of its radius in each robot's frame, a bar ahead, and its name."""
    entities = []
    for number, (robot, radius) in enumerate(radius_m.items()):
        colour = _HULLS[number % len(_HULLS)]
        bar = {"pose": _pose(radius / 2, 0.0, _HULL_M), "size": _vector(radius, 0.03, 0.03), "color": _colour(_INK)}
        disc = _cylinder(0.0, 0.0, radius, _HULL_M, colour)
        label = _label(0.0, 0.0, _HULL_M, robot)
        entities.append(_entity(f"{robot}/hull", base_frame(robot), [bar], [disc], [label]))
    return {"deletions": [], "entities": entities}


def _entity(
    name: str,
    frame_id: str,
    cubes: Sequence[Message],
    cylinders: Sequence[Message],
    texts: Sequence[Message],
) -> Message:
    return {
        "timestamp": _stamp(0.0),
        "frame_id": frame_id,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "cubes": cubes,
        "cylinders": cylinders,
        "texts": texts,
        **{shape: [] for shape in UNUSED_SHAPES},
    }


_WALL_M: Final = 0.05
_LOW_WALL_M: Final = 0.25
"""Walls are drawn low so that they hide nothing."""


def _walls(world: WorldModel) -> Iterable[Message]:
    width_m, depth_m = world.size_m
    for sign in (-1, 1):
        for x_m, y_m, size in (
            (sign * (width_m + _WALL_M) / 2, 0.0, (_WALL_M, depth_m + 2 * _WALL_M)),
            (0.0, sign * (depth_m + _WALL_M) / 2, (width_m, _WALL_M)),
        ):
            pose = _pose(x_m, y_m, _LOW_WALL_M / 2)
            yield {"pose": pose, "size": _vector(*size, _LOW_WALL_M), "color": _colour(_GREY)}


def _cube(part: BoxObstacle | MovableBox | Drop, height_m: float, colour: Sequence[float]) -> Message:
    pose = _pose(part.x_m, part.y_m, height_m / 2, math.radians(part.yaw_deg))
    return {"pose": pose, "size": _vector(*part.size_m, height_m), "color": _colour(colour)}


def _cylinder(x_m: float, y_m: float, radius_m: float, height_m: float, colour: Sequence[float]) -> Message:
    return {
        "pose": _pose(x_m, y_m, height_m / 2),
        "size": _vector(2 * radius_m, 2 * radius_m, height_m),
        "bottom_scale": 1.0,
        "top_scale": 1.0,
        "color": _colour(colour),
    }


def _label(x_m: float, y_m: float, height_m: float, text: str) -> Message:
    return {
        "pose": _pose(x_m, y_m, height_m + _LABEL_M),
        "billboard": True,
        "font_size": _LABEL_M,
        "scale_invariant": False,
        "color": _colour(_INK),
        "text": text,
    }
