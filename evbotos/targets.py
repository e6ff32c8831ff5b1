"""Compiler settings of each architecture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from evbotos.model import Architecture


@dataclass(frozen=True, slots=True)
class CompilerTarget:
    """Compiler settings of an architecture.

    Attributes:
        compiler: the prefix of the compiler's programs.
        package: the Debian package of the compiler.
        multiarch: the folder of its libraries.
        flags: the flags for the platform's minimum processor.
    """

    compiler: str
    package: str
    multiarch: str
    flags: str


TARGETS: Final[dict[Architecture, CompilerTarget]] = {
    "amd64": CompilerTarget("x86_64-linux-gnu-", "gcc", "x86_64-linux-gnu", ""),
    "arm64": CompilerTarget("aarch64-linux-gnu-", "gcc-aarch64-linux-gnu", "aarch64-linux-gnu", ""),
    "armhf": CompilerTarget(
        "arm-linux-gnueabihf-",
        "gcc-arm-linux-gnueabihf",
        "arm-linux-gnueabihf",
        "-march=armv7-a -mfpu=vfpv3-d16 -mfloat-abi=hard",
    ),
    "i386": CompilerTarget(
        "i686-linux-gnu-", "gcc-i686-linux-gnu", "i386-linux-gnu", "-march=i686 -msse2 -mfpmath=sse"
    ),
}
