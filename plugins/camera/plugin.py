"""The camera plugin: one camera of a robot, whatever its pictures come from (Source: thesis §6.2.2)."""

# ruff: noqa: N802  # create_Camera and its like are what the plugin API calls

from __future__ import annotations

from pathlib import Path
from typing import Final, Self

from pydantic import field_validator, model_validator

from eal_actors.plugin import EALPlugin, Field, PluginContext, PluginError, PluginSettingsModel

from .camera import KINDS, Camera, Format, Mount
from .reader import Reader, Terms
from .source import Kind, Source

_ONLY_FOR: Final = {
    "width": (Kind.DEVICE,),
    "height": (Kind.DEVICE,),
    "exposure": (Kind.DEVICE,),
    "fourcc": (Kind.DEVICE,),
    "fps": (Kind.DEVICE, Kind.FOLDER),
    "loop": (Kind.FILE, Kind.FOLDER),
    "frozen_after_s": (Kind.DEVICE, Kind.STREAM),
}
"""The settings that only some kinds of source have."""


class Settings(PluginSettingsModel):
    """What the fleet file may set."""

    source: int | str
    """The number n of `/dev/video<n>`, a path below /dev, a URL, or the path of a video file or folder of images."""
    format: Format = "raw"
    """What get_value answers: an array, or the bytes of a JPEG or PNG file."""
    width: int | None = Field(default=None, ge=16, le=4096)
    """Width to ask the camera for, in pixels."""
    height: int | None = Field(default=None, ge=16, le=4096)
    """Height to ask the camera for, in pixels."""
    fps: float | None = Field(default=None, ge=1, le=1000)
    """Rate to ask the camera for, in pictures a second; of a folder of images, its rate, 1 if left out."""
    exposure: float | None = Field(default=None, ge=0, le=16)
    """Factor on the exposure that the camera has when it is opened; left out or 1, it chooses by itself."""
    fourcc: str | None = Field(default=None, pattern=r"^[ -~]{4}$")
    """How the camera is to code its pictures on the cable, such as MJPG or YUYV."""
    loop: bool = False
    """Begin a video file or folder anew at its end."""
    fov_deg: float | None = Field(default=None, ge=10, le=150)
    """Angle between the left and the right edge of the picture: for `intrinsics`."""
    offset_m: float = Field(default=0.0, ge=-1, le=1)
    """How far ahead of the axis that it turns on the camera is."""
    timeout_s: float = Field(default=2.0, ge=0.1, le=60)
    """Seconds without a picture after which the source counts as frozen or gone, and callers wait no longer."""
    frozen_after_s: float | None = Field(default=5.0, ge=0.1)
    """Real seconds of one and the same picture after which a live source counts as frozen; null for never."""

    @field_validator("source")
    @classmethod
    def _check_source(cls, source: int | str) -> int | str:
        if source == "" or (isinstance(source, int) and source < 0):
            raise ValueError("wanted is a number from 0, a device path, a URL, or the path of a file or folder")
        Source.of(source)
        return source

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        source = Source.of(self.source)
        kind = source.kind
        could_be = {kind} if kind.is_live or Path(source.address).exists() else {Kind.FILE, Kind.FOLDER}
        for key, kinds in _ONLY_FOR.items():
            if key in self.model_fields_set and could_be.isdisjoint(kinds):
                wanted = " or ".join(f"a {kind.value}" for kind in kinds)
                raise ValueError(f"{key} is for {wanted}, and this source is a {kind.value}")
        return self

    def wishes(self) -> dict[str, float]:
        """Return what to ask of the source."""
        asked = {"width": self.width, "height": self.height, "fps": self.fps, "exposure": self.exposure}
        return {key: value for key, value in asked.items() if value is not None}


class CameraPlugin(EALPlugin):
    """One source of pictures."""

    def __init__(self, source: Source) -> None:
        super().__init__("Camera")
        self.source = source


def connect(context: PluginContext) -> CameraPlugin:
    """Look whether there can be such a source. A camera that is not plugged in is no error: it is not ready.

    Raises:
        PluginError: a file or folder is missing, or is none that can be read.

    Thread: the robot's; reads the head of a file.
    """
    settings: Settings = context.settings
    source = Source.of(settings.source)
    if not source.kind.is_live:
        path = Path(source.address)
        if not path.is_file() and not path.is_dir():
            what = "is no file" if path.exists() else "does not exist"
            raise PluginError(f"source {source.name!r} {what}; the working directory is {Path.cwd()}")
        try:
            source.opener(loop=settings.loop, fps=settings.fps, fourcc=None, timeout_s=settings.timeout_s)().release()
        except OSError as error:
            raise PluginError(f"source {source.name!r}: {error}") from error
    return CameraPlugin(source)


def disconnect(plugin: CameraPlugin) -> None:
    """Let go of nothing: the resource has closed its source."""


def create_Camera(context: PluginContext) -> Camera:
    """Make the resource, with a reader of its own."""
    settings: Settings = context.settings
    source: Source = context.plugin.source
    terms = Terms(
        name=source.name,
        patience_s=settings.timeout_s,
        frozen_after_s=settings.frozen_after_s if source.kind.is_live else None,
        wishes=settings.wishes(),
        place={"robot": context.robot, "resource": "Camera"},
    )
    opener = source.opener(loop=settings.loop, fps=settings.fps, fourcc=settings.fourcc, timeout_s=settings.timeout_s)
    mount = Mount(f"{context.robot}/camera", settings.fov_deg, settings.offset_m)
    return KINDS[settings.format](Reader(opener, terms, context.clock), mount)


def destroy_Camera(resource: Camera) -> None:
    """Let go of what `create_Camera` took: nothing, `close` has let go of the source."""
