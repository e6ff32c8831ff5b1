"""The log of a block, line by line in JSON."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager

import structlog

from eal_actors.kernel.log import configure_logging


@contextmanager
def log_lines(level: str = "info") -> Iterator[io.StringIO]:
    lines = io.StringIO()
    configure_logging("json", level, lines)
    try:
        yield lines
    finally:
        structlog.reset_defaults()
