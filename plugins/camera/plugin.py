"""The camera plugin: one camera of a robot, with any source of pictures (Source: thesis §6.2.2)."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Final, Self

from pydantic import field_validator, model_validator

from eal_actors.plugin import FactoryPlugin, Field, PluginContext, PluginError, PluginSettingsModel

from .camera import KINDS, Camera, Format, Mount
from .reader import ReaderOptions, SourceReader
from .source import PictureSource, SourceKind

_ONLY_FOR: Final = {
    "width": (SourceKind.DEVICE,),
    "height": (SourceKind.DEVICE,),
    "exposure": (SourceKind.DEVICE,),
    "fourcc": (SourceKind.DEVICE,),
    "fps": (SourceKind.DEVICE, SourceKind.FOLDER),
    "frozen_after_s": (SourceKind.DEVICE, SourceKind.STREAM, SourceKind.PROGRAM),
}
"""The settings of only some kinds of source."""


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    source: int | str | list[int | float | str]
    """The number n of `/dev/video<n>`, a path below /dev, a URL, the path of a video file or folder of images, or the
    list of a program, which writes JPEG pictures to its standard output, and its arguments."""
    format: Format = "raw"
    """Format of get_value: an array, or the bytes of a JPEG or PNG file."""
    width: int | None = Field(default=None, ge=16, le=4096)
    """Requested width, in pixels."""
    height: int | None = Field(default=None, ge=16, le=4096)
    """Requested height, in pixels."""
    fps: float | None = Field(default=None, ge=1, le=1000)
    """Requested rate of a camera, or rate of a folder of images (default 1), in pictures per second."""
    exposure: float | None = Field(default=None, ge=0, le=16)
    """Factor on the exposure at opening; automatic if left out or 1."""
    fourcc: str | None = Field(default=None, pattern=r"^[ -~]{4}$")
    """Encoding of the pictures on the cable, such as MJPG or YUYV."""
    loop: bool = False
    """Restart a video file or folder at its end; other sources have none."""
    fov_deg: float | None = Field(default=None, ge=10, le=150)
    """Angle between the left and the right edge of the picture, for `intrinsics`."""
    offset_m: float = Field(default=0.0, ge=-1, le=1)
    """Distance of the camera ahead of its axis of rotation."""
    timeout_s: float = Field(default=2.0, ge=0.1, le=60)
    """Seconds without a picture after which the source counts as frozen or lost, and calls fail."""
    frozen_after_s: float | None = Field(default=5.0, ge=0.1)
    """Real seconds of an identical picture after which a live source counts as frozen; null for never."""

    @field_validator("source")
    @classmethod
    def _check_source(cls, source: int | str | list[int | float | str]) -> int | str | list[int | float | str]:
        if source in ("", []) or (isinstance(source, int) and source < 0):
            raise ValueError("use a number from 0, a device path, a URL, the path of a file or folder, or a program")
        PictureSource.of(source)
        return source

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        source = PictureSource.of(self.source)
        kind = source.kind
        could_be = {kind} if kind.is_live or Path(source.address).exists() else {SourceKind.FILE, SourceKind.FOLDER}
        for key, kinds in _ONLY_FOR.items():
            if key in self.model_fields_set and could_be.isdisjoint(kinds):
                wanted = " or ".join(f"a {kind.value}" for kind in kinds)
                raise ValueError(f"{key} is for {wanted}, but this source is a {kind.value}")
        return self

    def wishes(self) -> dict[str, float]:
        """Return the requested settings of the source."""
        wishes = {"width": self.width, "height": self.height, "fps": self.fps, "exposure": self.exposure}
        return {key: value for key, value in wishes.items() if value is not None}


def connect(context: PluginContext) -> FactoryPlugin:
    """Check the source. An unplugged camera is no error: it is not ready.

    Raises:
        PluginError: a file, folder or program is missing, or a file or folder is unreadable.

    Thread: the robot's; reads the head of a file.
    """
    settings: Settings = context.settings
    source = PictureSource.of(settings.source)
    if source.kind is SourceKind.PROGRAM and shutil.which(source.arguments[0]) is None:
        raise PluginError(f"source: this machine has no program {source.arguments[0]!r}")
    if not source.kind.is_live:
        path = Path(source.address)
        if not path.is_file() and not path.is_dir():
            what = "is not a file" if path.exists() else "does not exist"
            raise PluginError(f"source {source.name!r} {what}; the working directory is {Path.cwd()}")
        try:
            source.opener(loop=settings.loop, fps=settings.fps, fourcc=None, timeout_s=settings.timeout_s)().release()
        except OSError as error:
            raise PluginError(f"source {source.name!r}: {error}") from error
    return FactoryPlugin({"Camera": lambda: _camera(context, source)})


def disconnect(plugin: FactoryPlugin) -> None:
    """Do nothing: the resource has closed its source."""


def _camera(context: PluginContext, source: PictureSource) -> Camera:
    """Create the resource, with its own reader."""
    settings: Settings = context.settings
    options = ReaderOptions(
        name=source.name,
        patience_s=settings.timeout_s,
        frozen_after_s=settings.frozen_after_s if source.kind.is_live else None,
        wishes=settings.wishes(),
        place={"robot": context.robot, "resource": "Camera"},
    )
    opener = source.opener(loop=settings.loop, fps=settings.fps, fourcc=settings.fourcc, timeout_s=settings.timeout_s)
    mount = Mount(f"{context.robot}/camera", settings.fov_deg, settings.offset_m)
    return KINDS[settings.format](SourceReader(opener, options, context.clock), mount)
