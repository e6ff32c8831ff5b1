"""What a fleet file calls a source: which of the four kinds it is, and how it is opened."""

from __future__ import annotations

import enum
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import SplitResult, urlsplit

from .capture import Capture
from .device import open_device
from .files import ImageFolder, VideoFile
from .stream import open_stream

SCHEMES: Final = ("rtsp", "rtsps", "http", "https")


class Kind(enum.Enum):
    """Where pictures come from; the value is for people."""

    DEVICE = "camera"
    STREAM = "stream"
    FILE = "video file"
    FOLDER = "folder of images"

    @property
    def is_live(self) -> bool:
        """Whether it shows what is now: the same picture again and again would then be a fault."""
        return self in (Kind.DEVICE, Kind.STREAM)


@dataclass(frozen=True)
class Source:
    """A source of pictures.

    Attributes:
        kind: which of the four.
        address: its device path, URL, or path.
    """

    kind: Kind
    address: str

    @classmethod
    def of(cls, source: int | str) -> Source:
        """Read what the fleet file says.

        Args:
            source: number n of `/dev/video<n>`, a path below `/dev`, a URL, or the path of a file or folder.

        Raises:
            ValueError: there can be no such source.
        """
        if isinstance(source, int):
            return cls(Kind.DEVICE, f"/dev/video{source}")
        if "://" in source:
            parts = _parts(source)
            if parts.scheme not in SCHEMES or not parts.hostname:
                wanted = ", ".join(f"{scheme}://" for scheme in SCHEMES)
                raise ValueError(f"source {without_secrets(source)!r}: wanted is a URL with {wanted} and a host")
            return cls(Kind.STREAM, source)
        if source.startswith("/dev/"):
            return cls(Kind.DEVICE, source)
        path = Path(source).expanduser()
        return cls(Kind.FOLDER if path.is_dir() else Kind.FILE, str(path))

    @property
    def name(self) -> str:
        """What messages call it: its address without what is secret in it."""
        return without_secrets(self.address) if self.kind is Kind.STREAM else self.address

    def opener(self, *, loop: bool, fps: float | None, fourcc: str | None, timeout_s: float) -> Callable[[], Capture]:
        """Return what opens it; that raises OSError as long as it cannot be opened.

        Args:
            loop: begin a file or folder anew at its end.
            fps: images of a folder a second; None for 1.
            fourcc: how a device is to code its pictures; None to leave it as it is.
            timeout_s: real seconds that a stream may stay silent.
        """
        openers: dict[Kind, Callable[[], Capture]] = {
            Kind.DEVICE: lambda: open_device(self.address, fourcc),
            Kind.STREAM: lambda: open_stream(self.address, self.name, timeout_s),
            Kind.FILE: lambda: VideoFile(Path(self.address), loop=loop),
            Kind.FOLDER: lambda: ImageFolder(Path(self.address), loop=loop, fps=fps or 1.0),
        }
        return openers[self.kind]


def without_secrets(url: str) -> str:
    """Return a URL without the password, and without the query, where some cameras want one."""
    return re.sub(r"\?.*", "?***", re.sub(r"(?<=://)([^/@]*?):[^/]*@", r"\1:***@", url))


def _parts(url: str) -> SplitResult:
    try:
        return urlsplit(url)
    except ValueError as error:
        raise ValueError(f"source {without_secrets(url)!r}: it is no URL: {error}") from None
