"""A camera that a program reads, such as `rpicam-vid` of libcamera: it writes JPEG pictures to its standard output."""

from __future__ import annotations

import contextlib
import os
import re
import selectors
import signal
import subprocess
from collections.abc import Mapping, Sequence
from typing import IO, Final

import cv2
import numpy as np
from typing_extensions import override

from .capture import Capture, Image, real_s, refuse_all

MAX_PICTURE_BYTES: Final = 16 * 1024**2

_CHUNK_BYTES: Final = 64 * 1024
"""Capacity of a pipe."""
_MAX_OLD_CHUNKS: Final = 64
"""Chunks of the past that are thrown away at once; a program that writes without a pause would have no end of them."""
_WORDS_BYTES: Final = 1000
_END_S: Final = 1.0

_START: Final = b"\xff\xd8"
_END: Final = 0xD9
_SCAN: Final = 0xDA
_AFTER_SCAN: Final = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")
"""A marker that ends entropy-coded data; stuffed zeros, restart markers and fill bytes do not."""


class JpegSplitter:
    """Cuts a stream of JPEG files apart.

    A file ends at its own end marker, not at that of a preview within one of its segments. Source: ITU-T T.81, annex B.
    """

    def __init__(self) -> None:
        self._data = bytearray()
        self._at = 0
        self._is_in_scan = False

    def feed(self, data: bytes) -> list[bytes]:
        """Return the files that the next bytes complete.

        Raises:
            OSError: the stream is not of JPEG files, or one is too large.
        """
        self._data += data
        files = []
        while (end := self._find_end()) is not None:
            files.append(bytes(self._data[:end]))
            del self._data[:end]
            self._at = 0
        if len(self._data) > MAX_PICTURE_BYTES:
            raise OSError(f"a picture has more than {MAX_PICTURE_BYTES // 1024**2} MiB")
        return files

    def _find_end(self) -> int | None:
        """Return the length of the first file; None if it is incomplete."""
        data = self._data
        if self._at == 0:
            if data[:2] != _START[: len(data)]:
                raise OSError("its output is not a series of JPEG pictures; rpicam-vid needs `--codec mjpeg`")
            if len(data) < len(_START):
                return None
            self._at = len(_START)
        while True:
            if self._is_in_scan:
                found = _AFTER_SCAN.search(data, self._at)
                if found is None:
                    self._at = max(self._at, len(data) - 1)
                    return None
                self._at, self._is_in_scan = found.start(), False
            if len(data) < self._at + 2:
                return None
            mark, kind = data[self._at : self._at + 2]
            if mark != 0xFF:
                raise OSError("its output contains a broken JPEG picture")
            if kind == _END:
                return self._at + 2
            if kind == 0xFF:  # a fill byte
                self._at += 1
                continue
            if len(data) < self._at + 4:
                return None
            self._at += 2 + int.from_bytes(data[self._at + 2 : self._at + 4], "big")
            self._is_in_scan = kind == _SCAN


class ProgramStream(Capture):
    """A running program, whose arguments determine the size and rate of its pictures.

    Args:
        timeout_s: real seconds without a picture after which it counts as lost.

    Raises:
        OSError: it cannot be started.
    """

    period_s: float | None = None

    def __init__(self, arguments: Sequence[str], timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._splitter = JpegSplitter()
        self._words = b""
        self._size: dict[str, float] = {}
        self._process = subprocess.Popen(  # noqa: S603  # the fleet file names it
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            process_group=0,  # Ctrl-C is for the robot, which ends the program
        )
        self._selector = selectors.DefaultSelector()
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:  # always
                os.set_blocking(stream.fileno(), False)
                self._selector.register(stream, selectors.EVENT_READ)

    @override
    def read(self) -> Image:
        for _ in range(_MAX_OLD_CHUNKS):
            if self._receive(0.0) is None:
                break
        end_s = real_s() + self._timeout_s
        while not (pictures := self._receive(max(end_s - real_s(), 0.0))):
            if real_s() >= end_s:
                raise OSError(f"the program has written no picture for {self._timeout_s:g} s{self._last_words()}")
        image = cv2.imdecode(np.frombuffer(pictures[-1], np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise OSError("its output contains a broken JPEG picture")
        self._size = {"height": image.shape[0], "width": image.shape[1]}
        return np.asarray(image, np.uint8)

    def _receive(self, wait_s: float) -> list[bytes] | None:
        """Return the pictures that new bytes complete; None if there are no bytes within a time."""
        events = self._selector.select(wait_s)
        pictures: list[bytes] = []
        for key, _ in events:
            stream: IO[bytes] = key.fileobj  # type: ignore[assignment]  # as registered
            data = stream.read(_CHUNK_BYTES)
            if data is None:  # not ready after all
                continue
            if not data:
                self._selector.unregister(stream)
                if stream is self._process.stdout:
                    raise OSError(f"the program has ended{self._exit()}{self._last_words()}")
            elif stream is self._process.stdout:
                pictures += self._splitter.feed(data)
            else:
                self._words = (self._words + data)[-_WORDS_BYTES:]
        return pictures if events else None

    def _exit(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return f" with exit code {self._process.wait(_END_S)}"
        return ""

    def _last_words(self) -> str:
        """Return the last line of the program's standard error, for messages."""
        with contextlib.suppress(OSError):
            if self._process.stderr is not None:
                self._words = (self._words + (self._process.stderr.read() or b""))[-_WORDS_BYTES:]
        lines = self._words.decode(errors="replace").split("\n")
        return next((f": {line.strip()}" for line in reversed(lines) if line.strip()), "")

    @override
    def mode(self) -> dict[str, float]:
        return {"exposure": 1.0}

    @override
    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        return refuse_all("program", {**self._size, **self.mode()}, wishes)

    @override
    def release(self) -> None:
        self._selector.close()
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_END_S)
                break
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:  # always
                stream.close()
