"""The benchmark of the thesis's chapter 5: eight matrix operations, compared with the thesis's boards."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

from evbotos.errors import BuildError

SCRIPTS: Final = Path(__file__).parent / "benchmark"
Engine = Literal["octave", "numpy"]

THESIS_N: Final = 1000
OPERATIONS: Final = {
    "create": "creation",
    "multiply": "multiplication",
    "lu": "LU decomposition",
    "inverse": "inverse",
    "svd": "singular value decomposition",
    "qr": "QR decomposition",
    "eigen": "eigenvalues and eigenvectors",
    "rank": "rank",
}
"""By name, in the thesis's order."""
BOARDS: Final[dict[str, tuple[float, ...]]] = {
    "MZ104": (5.61, 1157.30, 380.58, 1142.08, 1488.04, 680.46, 3574.38, 403.51),
    "SBC1496": (6.75, 1460.95, 462.66, 1412.69, 1851.99, 850.86, 4433.89, 498.84),
    "BeagleBoard": (0.51, 272.19, 105.51, 317.17, 420.96, 203.85, 1103.65, 107.41),
}
"""Seconds at n = 1000 with Octave, in the order of OPERATIONS (Source: thesis, table 5.3)."""
BUILD_TIMES_S: Final[dict[str, tuple[int, int]]] = {
    "MZ104": (7 * 3600 + 38 * 60 + 51, 3600 + 13 * 60),
    "SBC1496": (7 * 3600 + 42 * 60 + 41, 3600 + 13 * 60 + 29),
    "BeagleBoard": (7 * 3600 + 50 * 60 + 27, 3600 + 18 * 60 + 38),
}
"""Seconds to build the base image on two and on eight cores (Source: thesis, table 5.1)."""


@dataclass(frozen=True, slots=True)
class Benchmark:
    """The result of a benchmark run.

    Attributes:
        engine: name and version.
        where: the machine.
        n: rows and columns of the matrix.
        seconds: by operation.
    """

    engine: str
    where: str
    n: int
    seconds: dict[str, float]

    @property
    def total_s(self) -> float:
        """The sum of all operations."""
        return sum(self.seconds.values())

    def as_json(self) -> dict[str, Any]:
        """Return plain data, including the thesis's boards."""
        boards = {name: dict(zip(OPERATIONS, times, strict=True)) for name, times in BOARDS.items()}
        return {**asdict(self), "total_s": round(self.total_s, 6), "thesis": {"n": THESIS_N, "boards": boards}}


def script_of(engine: Engine) -> Path:
    """Return the program of an engine."""
    return SCRIPTS / ("octave.m" if engine == "octave" else "numpy_engine.py")


def run_here(engine: Engine, n: int, program: str, timeout_s: float) -> Benchmark:
    """Run the benchmark on this machine.

    Args:
        engine: the numeric engine.
        n: rows and columns of the matrix.
        program: octave-cli, or a Python with numpy.
        timeout_s: time limit in real seconds.

    Raises:
        BuildError: the engine is missing, returns wrong results or exceeds the time limit.
    """
    options = ["--norc", "--quiet", "--no-history"] if engine == "octave" else []
    return run_by([program, *options, str(script_of(engine)), str(n)], None, n, here(), timeout_s)


def run_by(argv: Sequence[str], data: bytes | None, n: int, where: str, timeout_s: float) -> Benchmark:
    """Run the benchmark as a command and parse its output.

    Args:
        argv: the command.
        data: its input.
        n: rows and columns of the matrix.
        where: a description of the machine.
        timeout_s: time limit in real seconds.

    Raises:
        BuildError: it fails or exceeds the time limit; includes its last output.
    """
    try:
        done = subprocess.run(  # noqa: S603  # our own programs
            list(argv), input=data or b"", capture_output=True, timeout=timeout_s, check=False
        )
    except FileNotFoundError:
        raise BuildError(f"{argv[0]} is not installed") from None
    except subprocess.TimeoutExpired:
        raise BuildError(f"the benchmark takes longer than {timeout_s:g} s; use a smaller --n") from None
    said = done.stderr.decode(errors="replace").strip()
    if done.returncode:
        raise BuildError(f"the benchmark failed: {said or f'exit code {done.returncode}'}")
    return read_results(done.stdout.decode(), n, where)


def read_results(text: str, n: int, where: str) -> Benchmark:
    """Parse the output of an engine.

    Raises:
        BuildError: the output is malformed, or an operation is missing.
    """
    engine, seconds = "", dict[str, float]()
    try:
        for line in filter(None, map(str.strip, text.splitlines())):
            told = json.loads(line)
            if "engine" in told:
                engine = str(told["engine"])
            else:
                seconds[told["operation"]] = float(told["seconds"])
    except (ValueError, KeyError, TypeError):
        raise BuildError(f"the benchmark printed an invalid line: {line!r}") from None
    if list(seconds) != list(OPERATIONS) or not engine:
        missing = ", ".join(name for name in OPERATIONS if name not in seconds)
        raise BuildError(f"the benchmark is incomplete; missing: {missing or 'the engine'}")
    return Benchmark(engine, where, n, seconds)


def here() -> str:
    """Return a description of this machine."""
    return f"{platform.machine()}, {_processor()}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown processor"
    return next((line.partition(":")[2].strip() for line in lines if line.startswith(("model name", "Model"))), "?")


def default_program(engine: Engine) -> str:
    """Return the default program of an engine on this machine."""
    return "octave-cli" if engine == "octave" else sys.executable
