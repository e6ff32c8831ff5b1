"""JSON Schemas of the messages of `run.mcap`: Foxglove's, which its viewers display, and our own.

Source: the message schemas of the Foxglove documentation, reduced to the parts that are used.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, TypeAlias

_Schema: TypeAlias = dict[str, Any]

_NUMBER: Final[_Schema] = {"type": "number"}
_TEXT: Final[_Schema] = {"type": "string"}
_FLAG: Final[_Schema] = {"type": "boolean"}
_WHOLE: Final[_Schema] = {"type": "integer"}


def _object(**properties: _Schema) -> _Schema:
    return {"type": "object", "properties": properties}


def _numbers(names: str) -> _Schema:
    return _object(**dict.fromkeys(names.split(), _NUMBER))


def _list(items: _Schema) -> _Schema:
    return {"type": "array", "items": items}


_TIME: Final = {**_object(sec=_WHOLE, nsec=_WHOLE), "title": "time"}
_DURATION: Final = {**_object(sec=_WHOLE, nsec=_WHOLE), "title": "duration"}
_VECTOR: Final = _numbers("x y z")
_QUATERNION: Final = _numbers("x y z w")
_COLOUR: Final = _numbers("r g b a")
_POSE: Final = _object(position=_VECTOR, orientation=_QUATERNION)
_TRANSFORM: Final = _object(
    timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_VECTOR, rotation=_QUATERNION
)
UNUSED_SHAPES: Final = ("metadata", "arrows", "spheres", "lines", "triangles", "models")
"""Required members of Foxglove's entity that an arena has no use for; strict readers insist on them."""
_ENTITY: Final = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked=_FLAG,
    cubes=_list(_object(pose=_POSE, size=_VECTOR, color=_COLOUR)),
    cylinders=_list(_object(pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOUR)),
    texts=_list(
        _object(pose=_POSE, billboard=_FLAG, font_size=_NUMBER, scale_invariant=_FLAG, color=_COLOUR, text=_TEXT)
    ),
    **{shape: {"type": "array", "maxItems": 0} for shape in UNUSED_SHAPES},
)


class MessageSchema(NamedTuple):
    """A schema with its name."""

    name: str
    schema: _Schema


POSE: Final = MessageSchema("foxglove.PoseInFrame", _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE))
POSES: Final = MessageSchema("foxglove.PosesInFrame", _object(timestamp=_TIME, frame_id=_TEXT, poses=_list(_POSE)))
TRANSFORMS: Final = MessageSchema("foxglove.FrameTransforms", _object(transforms=_list(_TRANSFORM)))
_DATA: Final = {**_TEXT, "contentEncoding": "base64"}
IMAGE: Final = MessageSchema(
    "foxglove.CompressedImage", _object(timestamp=_TIME, frame_id=_TEXT, data=_DATA, format=_TEXT)
)
SCAN: Final = MessageSchema(
    "foxglove.LaserScan",
    _object(
        timestamp=_TIME,
        frame_id=_TEXT,
        pose=_POSE,
        start_angle=_NUMBER,
        end_angle=_NUMBER,
        ranges=_list(_NUMBER),
        intensities=_list(_NUMBER),
        invalid=_list(_WHOLE),  # our own: the indices of ranges that are NaN
    ),
)
LOG: Final = MessageSchema(
    "foxglove.Log", _object(timestamp=_TIME, level=_WHOLE, message=_TEXT, name=_TEXT, file=_TEXT, line=_WHOLE)
)
_DELETION: Final = _object(timestamp=_TIME, type=_WHOLE, id=_TEXT)
SCENE: Final = MessageSchema("foxglove.SceneUpdate", _object(deletions=_list(_DELETION), entities=_list(_ENTITY)))
VALUE: Final = MessageSchema(
    "eal.Value",
    _object(
        timestamp=_TIME,
        frame_id=_TEXT,
        type=_TEXT,
        modifiers=_list(_TEXT),
        unit=_TEXT,
        dtype=_TEXT,
        shape=_list(_WHOLE),
        value={},
    ),
)
"""Any value for which Foxglove has no schema, with its type, unit and shape."""
FINDINGS: Final = MessageSchema(
    "eal.Findings", _object(timestamp=_TIME, camera=_TEXT, stamp_s=_NUMBER, found=_object())
)
"""Findings in a picture of a simulated camera; `stamp_s` is its time by the fleet's clock, with all bits."""
EVENT: Final = MessageSchema("eal.Event", _object(timestamp=_TIME, event=_TEXT))
"""A line of `events.jsonl`."""
STATE: Final = MessageSchema(
    "eal.State",
    _object(
        timestamp=_TIME,
        robots=_list(_object(name=_TEXT, state=_TEXT, stopped=_TEXT, running=_list(_TEXT), not_ready=_list(_TEXT))),
    ),
)
"""The states of all robots, in live views."""
COMMAND: Final = MessageSchema(
    "eal.Command",
    _object(
        timestamp=_TIME,
        resource=_TEXT,
        method=_TEXT,
        command=_TEXT,
        step=_TEXT,
        outcome=_TEXT,
        duration_s=_NUMBER,
        error=_TEXT,
    ),
)
"""A completed call of a robot; its time is that of its begin."""
