"""The resource that receives an update."""

from __future__ import annotations

import json
from collections.abc import Generator
from pathlib import Path
from typing import Final

from eal_actors.plugin import (
    ArgumentError,
    DataType,
    EALData,
    Resource,
    ResourceType,
    ValueInfo,
    command,
    request,
)

from .root_side import RootSide

_BYTES: Final = ValueInfo(DataType.VOID, description="bytes")
_DIGESTS: Final = ValueInfo(DataType.VOID, description="12 bytes for each block of 4096 bytes")
_JSON: Final = ValueInfo(DataType.CHAR, description="JSON")
_SIGNATURE_BYTES: Final = 64
_MOST_BYTES: Final = 2 << 20


class Update(Resource):
    """Receives an update of EvBotOS into the slot that does not run; get_status: 1 while it does.

    Args:
        root_side: the program that may write the slot.
        about: the folder with the image's description.
    """

    types = ResourceType.COMMUNICATION
    value = ValueInfo(DataType.CHAR, description="the running system, and the progress of an update")

    def __init__(self, root_side: RootSide, about: Path) -> None:
        self._root_side = root_side
        self._about = about
        self._stage = ""
        self._is_receiving = False

    def close(self) -> None:
        """End the connection."""
        self._root_side.close()

    def get_status(self) -> int:
        """Return whether an update is being received."""
        return int(self._is_receiving)

    def get_value(self) -> str:
        """Return the running release, and the stage of an update."""
        try:
            release = json.loads((self._about / "manifest.json").read_text())["release"]
        except (OSError, ValueError, KeyError):
            release = "unknown"
        return f"release {release}" + (f"; {self._stage}" if self._stage else "")

    @request("status", _JSON)
    def status(self) -> Generator[float, None, str]:
        """Return the slots' state: start, slot, good, due, release, platform, verity, other_verity."""
        if not self._root_side.exists():
            return "{}"
        answer = yield from self._root_side.ask("status")
        return answer.decode()

    @request("running_kernel", _DIGESTS)
    def running_kernel(self) -> Generator[float, None, bytes]:
        """Return the digests of the running kernel."""
        return self._digests("running", "kernel")

    @request("running_root", _DIGESTS)
    def running_root(self) -> Generator[float, None, bytes]:
        """Return the digests of the running root."""
        return self._digests("running", "root")

    @request("other_kernel", _DIGESTS)
    def other_kernel(self) -> Generator[float, None, bytes]:
        """Return the digests of the other slot's kernel."""
        return self._digests("other", "kernel")

    @request("other_root", _DIGESTS)
    def other_root(self) -> Generator[float, None, bytes]:
        """Return the digests of the other slot's root."""
        return self._digests("other", "root")

    @command("begin", _BYTES)
    def begin(self, content: bytes) -> Generator[float, None, None]:
        """Verify a manifest, preceded by its signature, and empty the other slot."""
        signature, signed = content[:_SIGNATURE_BYTES], content[_SIGNATURE_BYTES:]
        yield from self._root_side.ask("begin", signed + signature, signed=len(signed))
        self._is_receiving, self._stage = True, "an update begins"

    @command("stage", ValueInfo(DataType.CHAR, description="words"))
    def set_stage(self, words: str) -> None:
        """Say how far the update is, for dashboards."""
        self._stage = words[:200]

    def write_comm(self, data: EALData, length: int) -> Generator[float, None, int]:
        """Write pieces of the update into the other slot.

        Each is the struct `>cBQI`: `d` or `c`, part, place and length; then the data, or where it is in the running
        slot (`>BQ`).
        """
        payload = bytes(data.payload)[:length]
        if len(payload) != length or length > _MOST_BYTES:
            raise ArgumentError(f"a write has up to {_MOST_BYTES} bytes")
        return self._write(payload)

    @command("finish")
    def finish(self) -> Generator[float, None, None]:
        """Read the update back, compare it with its manifest, and let the next start try it."""
        answer = yield from self._root_side.ask("finish")
        self._is_receiving, self._stage = False, answer.decode()

    @command("restart")
    def restart(self) -> Generator[float, None, None]:
        """Restart the machine, which has an update to try."""
        yield from self._root_side.ask("restart")

    @command("fall_back")
    def fall_back(self) -> Generator[float, None, None]:
        """Let the next start try the former system, if the running one is new since this start."""
        yield from self._root_side.ask("fall_back")

    def _digests(self, slot: str, part: str) -> Generator[float, None, bytes]:
        if not self._root_side.exists():
            return b""
        return (yield from self._root_side.ask("digests", slot=slot, part=part, size=1 << 40))

    def _write(self, payload: bytes) -> Generator[float, None, int]:
        yield from self._root_side.ask("write", payload)
        return len(payload)
