"""Pages of the documentation that a measurement writes into, and what they say of the machine."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path
from typing import Final

END: Final = "<!-- end -->"


def machine() -> str:
    """Return what this machine is."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return f"{model or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def rows_between(page: Path, begin: str) -> list[list[str]]:
    """Return the cells of the table between a mark and the next END, without its head."""
    content = page.read_text(encoding="utf-8")
    start = content.index(begin)
    lines = content[start : content.index(END, start)].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return rows[2:]


def publish(text: str, page: Path | None, begin: str) -> None:
    """Print a table, and write it into a page if one is named."""
    sys.stdout.write(text + "\n")
    if page is not None:
        write_between(page, begin, text)


def write_between(page: Path, begin: str, text: str) -> None:
    """Put text into a page between a mark and the next END, in place of what was there.

    Raises:
        ValueError: the page has no such marks.
    """
    content = page.read_text(encoding="utf-8")
    start = content.index(begin) + len(begin)
    end = content.index(END, start)
    page.write_text(f"{content[:start]}\n\n{text}\n\n{content[end:]}", encoding="utf-8")
