"""The source setting of the fleet file: its kind, and how to open it."""

from __future__ import annotations

import enum
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import SplitResult, urlsplit

from .capture import Capture
from .device import open_device
from .files import ImageFolder, VideoFile
from .program import ProgramStream
from .stream import open_stream

SCHEMES: Final = ("rtsp", "rtsps", "http", "https")


class SourceKind(enum.Enum):
    """The kind of a source; the values are for messages."""

    DEVICE = "camera"
    STREAM = "stream"
    FILE = "video file"
    FOLDER = "folder of images"
    PROGRAM = "program"

    @property
    def is_live(self) -> bool:
        """Whether it shows the present: then identical pictures in a row are a fault."""
        return self in (SourceKind.DEVICE, SourceKind.STREAM, SourceKind.PROGRAM)


@dataclass(frozen=True)
class PictureSource:
    """A source of pictures.

    Attributes:
        address: its device path, URL, path, or command line.
    """

    kind: SourceKind
    address: str
    arguments: tuple[str, ...] = ()

    @classmethod
    def of(cls, source: int | str | Sequence[int | float | str]) -> PictureSource:
        """Parse the setting of the fleet file.

        Args:
            source: number n of `/dev/video<n>`, a path below `/dev`, a URL, the path of a file or folder, or a program
                and its arguments.

        Raises:
            ValueError: the source is invalid.
        """
        if isinstance(source, int):
            return cls(SourceKind.DEVICE, f"/dev/video{source}")
        if not isinstance(source, str):
            arguments = tuple(map(str, source))
            return cls(SourceKind.PROGRAM, shlex.join(arguments), arguments)
        if "://" in source:
            parts = _parts(source)
            if parts.scheme not in SCHEMES or not parts.hostname:
                wanted = ", ".join(f"{scheme}://" for scheme in SCHEMES)
                raise ValueError(f"source {without_secrets(source)!r}: use a URL with {wanted} and a host")
            return cls(SourceKind.STREAM, source)
        if source.startswith("/dev/"):
            return cls(SourceKind.DEVICE, source)
        path = Path(source).expanduser()
        return cls(SourceKind.FOLDER if path.is_dir() else SourceKind.FILE, str(path))

    @property
    def name(self) -> str:
        """Its name in messages: its address without secrets."""
        has_secrets = self.kind in (SourceKind.STREAM, SourceKind.PROGRAM)
        return without_secrets(self.address) if has_secrets else self.address

    def opener(self, *, loop: bool, fps: float | None, fourcc: str | None, timeout_s: float) -> Callable[[], Capture]:
        """Return a function that opens it, or raises OSError while it cannot be opened.

        Args:
            loop: restart a file or folder at its end.
            fps: images of a folder per second; None for 1.
            fourcc: encoding of a device's pictures; None to keep the present one.
            timeout_s: real seconds without data after which a stream or program counts as lost.
        """
        openers: dict[SourceKind, Callable[[], Capture]] = {
            SourceKind.DEVICE: lambda: open_device(self.address, fourcc),
            SourceKind.STREAM: lambda: open_stream(self.address, timeout_s),
            SourceKind.FILE: lambda: VideoFile(Path(self.address), loop=loop),
            SourceKind.FOLDER: lambda: ImageFolder(Path(self.address), loop=loop, fps=fps or 1.0),
            SourceKind.PROGRAM: lambda: ProgramStream(self.arguments, timeout_s),
        }
        return openers[self.kind]


def without_secrets(url: str) -> str:
    """Return a URL without the password and the query, which may contain a password."""
    return re.sub(r"\?.*", "?***", re.sub(r"(?<=://)([^/@]*?):[^/]*@", r"\1:***@", url))


def _parts(url: str) -> SplitResult:
    try:
        return urlsplit(url)
    except ValueError as error:
        raise ValueError(f"source {without_secrets(url)!r}: invalid URL: {error}") from None
