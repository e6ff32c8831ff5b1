"""The Camera resource: pictures of a real camera, with the interface of the simulated one."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, TypeAlias

import cv2
import numpy as np

from eal_actors.plugin import (
    Activity,
    DataType,
    EALData,
    Resource,
    ResourceFaultError,
    ResourceType,
    UnavailableError,
    ValueInfo,
    config,
    config_setter,
    request,
    setting,
)

from .capture import LEAST_FPS, MOST_FPS, Image
from .reader import SourceReader

Format: TypeAlias = Literal["raw", "jpeg", "png"]

_JPEG_QUALITY: Final = 90
_PNG_LEVEL: Final = 1  # of 0..9: the higher ones take several times as long to save a few per cent
_SIZE: Final = ValueInfo(DataType.INT, "px", 16, 4096)


@dataclass(frozen=True)
class Mount:
    """The properties that the device does not report.

    Attributes:
        frame_id: the name of the camera's frame of reference.
        fov_deg: angle between the left and the right edge of the picture; None if unknown.
        offset_m: distance of the camera ahead of its axis of rotation.
    """

    frame_id: str
    fov_deg: float | None = None
    offset_m: float = 0.0


class Camera(Resource):
    """Camera that returns current pictures."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(None, None, 3), description="RGB, rows from the top")
    format_name: ClassVar[Format] = "raw"

    offset_m: float = setting(
        ValueInfo(DataType.DOUBLE, "m", -1, 1), "Distance of the camera ahead of its axis of rotation."
    )

    def __init__(self, reader: SourceReader, mount: Mount) -> None:
        self._reader = reader
        self._frame_id = mount.frame_id
        self._fov_deg = mount.fov_deg
        self.offset_m = mount.offset_m

    def open(self) -> None:
        """Begin to open the source, in the reader's thread."""
        self._reader.start()

    def close(self) -> None:
        """Close the source. Thread: blocks the caller for at most three real seconds."""
        self._reader.close()

    def not_ready(self) -> str | None:
        """Return why there is no picture now, such as an unplugged camera; None if there is one."""
        return self._reader.why_not_ready()

    def get_value(self) -> Generator[float, None, EALData]:
        """Return a picture that was begun after this call, with its time of arrival.

        Raises:
            NotReadyError: the camera is lost, frozen, or at the end of its file.
            UnavailableError: none arrived in time, for an unknown reason.
            ResourceFaultError: the picture cannot be encoded.
        """
        frame = yield from self._reader.newer()
        return EALData.of(self._encode(frame.image), frame_id=self._frame_id, stamp_s=frame.stamp_s)

    def _encode(self, image: Image) -> Image | memoryview:
        """Return the picture in the format declared by `value`."""
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)

    @request("intrinsics", ValueInfo(DataType.DOUBLE, "px", shape=(3, 3)))
    def intrinsics(self) -> Generator[float, None, EALData]:
        """Return the camera matrix: from x right, y down, z ahead to pixels, the centre of the first one at 0, 0."""
        fov_rad, mode = math.radians(self.fov_deg()), (yield from self._reader.mode())
        width, height = mode["width"], mode["height"]
        focal_px = width / 2 / math.tan(fov_rad / 2)
        matrix = np.array([[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]])
        return EALData.of(matrix, unit="px")

    @config("width", _SIZE)
    def width(self) -> Generator[float, None, int]:
        """Width of the picture."""
        return int((yield from self._reader.mode())["width"])

    @config_setter("width")
    def set_width(self, width: int) -> Activity:
        """Set the width; the camera may refuse."""
        return self._reader.adjust({"width": width})

    @config("height", _SIZE)
    def height(self) -> Generator[float, None, int]:
        """Height of the picture."""
        return int((yield from self._reader.mode())["height"])

    @config_setter("height")
    def set_height(self, height: int) -> Activity:
        """Set the height; the camera may refuse."""
        return self._reader.adjust({"height": height})

    @config("fps", ValueInfo(DataType.DOUBLE, "Hz", LEAST_FPS, MOST_FPS))
    def fps(self) -> Generator[float, None, float]:
        """Pictures per second, as reported by the camera."""
        return self._reported((yield from self._reader.mode()), "fps")

    @config_setter("fps")
    def set_fps(self, fps: float) -> Activity:
        """Set the rate; the camera may refuse."""
        return self._reader.adjust({"fps": float(fps)})

    @config("fov_deg", ValueInfo(DataType.DOUBLE, "deg", 10, 150))
    def fov_deg(self) -> float:
        """Field of view, from the left edge of the picture to the right edge."""
        if self._fov_deg is None:
            raise UnavailableError("the field of view of this camera is unknown: set `fov_deg`")
        return self._fov_deg

    @config_setter("fov_deg")
    def set_fov_deg(self, fov_deg: float) -> None:
        """Set the known field of view; this does not change the lens."""
        self._fov_deg = float(fov_deg)

    @config("exposure", ValueInfo(DataType.DOUBLE, minimum=0, maximum=16, description="factor on the grey levels"))
    def exposure(self) -> Generator[float, None, float]:
        """Factor on the grey levels: 2 is twice as bright, clipped at white."""
        return self._reported((yield from self._reader.mode()), "exposure")

    @config_setter("exposure")
    def set_exposure(self, exposure: float) -> Activity:
        """Set the exposure; 1 is automatic, and the camera may refuse any other."""
        return self._reader.adjust({"exposure": float(exposure)})

    @config("format", ValueInfo(DataType.CHAR, choices=("raw", "jpeg", "png")))
    def format(self) -> str:
        """Format of a value, an array or the bytes of a file; set by the fleet file."""
        return self.format_name

    @staticmethod
    def _reported(mode: Mapping[str, float], key: str) -> float:
        if key not in mode:
            raise UnavailableError(f"the camera does not report its {key}")
        return mode[key]


class JpegCamera(Camera):
    """Camera that returns current pictures."""

    value = ValueInfo(DataType.VOID, description="the bytes of a JPEG file")
    format_name = "jpeg"

    def _encode(self, image: Image) -> memoryview:
        return _encode_file(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])


class PngCamera(Camera):
    """Camera that returns current pictures."""

    value = ValueInfo(DataType.VOID, description="the bytes of a PNG file")
    format_name = "png"

    def _encode(self, image: Image) -> memoryview:
        return _encode_file(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])


def _encode_file(suffix: str, image: Image, parameters: list[int]) -> memoryview:
    try:
        is_done, file = cv2.imencode(suffix, image, parameters)
    except cv2.error as error:
        raise ResourceFaultError(f"a picture of shape {image.shape} cannot be encoded: {error}") from error
    if not is_done:
        raise ResourceFaultError(f"a picture of shape {image.shape} cannot be encoded as {suffix}")
    return file.data


KINDS: Final[Mapping[Format, type[Camera]]] = {"raw": Camera, "jpeg": JpegCamera, "png": PngCamera}
"""The resource class of each format, because a class declares its type of value."""
