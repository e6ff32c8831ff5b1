"""Put the files of docs/examples into the pages that show them: `python -m tests.docs.examples`.

A page names the file in a comment before the block: `<!-- docs/examples/square.py -->`. The pages contain the text
itself, so that they can be read on a forge and in an editor too. A test fails where a page and a file differ.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
FOLDER: Final = ROOT / "docs/examples"
PAGES: Final = sorted((ROOT / "README.md", *(ROOT / "docs").rglob("*.md")))
_BLOCK: Final = re.compile(r"^<!-- (docs/examples/\S+) -->\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def shown(page: Path) -> dict[str, str]:
    """Return the text of each example that a page shows, by the example's path."""
    return dict(_BLOCK.findall(page.read_text(encoding="utf-8")))


def update(page: Path) -> bool:
    """Replace the examples of a page by the texts of their files; return whether it changed."""

    def replaced(block: re.Match[str]) -> str:
        return block[0].replace(block[2], (ROOT / block[1]).read_text(encoding="utf-8"))

    text = page.read_text(encoding="utf-8")
    new = _BLOCK.sub(replaced, text)
    page.write_text(new, encoding="utf-8")
    return new != text


if __name__ == "__main__":
    for each in PAGES:
        if update(each):
            sys.stdout.write(f"{each.relative_to(ROOT)}\n")
