"""Find phrases that do not belong in plain technical English: `python -m tests.house.prose`, a part of `make check`.

It reads every tracked text: Python, JavaScript, YAML, Markdown and templates. It ends with 1 if it finds a phrase.
The rules for prose are in CONTRIBUTING.md; this list holds the habits that must not come back.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
_HERE: Final = Path(__file__).relative_to(ROOT).as_posix()
_SUFFIXES: Final = (".py", ".md", ".yaml", ".yml", ".js", ".html", ".j2", ".txt", ".toml")

PHRASES: Final[dict[str, str]] = {
    r'"""What ': "begin with a noun phrase or a verb: Return ..., The ...",
    r'"""Who ': "begin with a noun phrase or a verb",
    r'"""Take in ': "apply, record, read",
    r'"""Do nothing, as above': "give the reason",
    r"\bnothing follows (?:it|them)\b": "is not an instruction",
    r"\b(?:a|the) hand's wish\b": "the wanted velocity",
    r'"""See [A-Z`]': "use @override without a docstring",
    r"\bwhoever\b": "name the role: the caller, the lease holder, the reader",
    r"\bwhomever\b": "name the role",
    r"\bso manieth\b": "every Nth",
    r"\b(?:is|are|was|were) told\b": "is reported, receives",
    r"\banswered (?:is|are)\b": "returns",
    r"\bgoes on as ever\b": "continues",
    r"\b(?:what )?comes of (?:it|them|that|this|a|an|the)\b": "the result",
    r"\bcame of (?:it|them|that|this|a|an|the)\b": "the result",
    r"\b(?:had|has|have) something to say\b": "logged, reported",
    r"\bhow (?:it|they|things) stands?\b": "the state",
    r"\b(?:what|all that) (?:it|they|one|somebody) bears?\b": "the limits; stress-test",
    r"\bthe house is built\b": "the design",
    r"\bwords that come late\b": "late messages",
    r"\bup to the clock\b": "stepped lazily",
    r"\bin good order\b": "cleanly",
    r"\bof its own accord\b": "automatically",
    r"\btake[sn]? notice\b": "note, record",
    r"\bnobody (?:waits|asks|wants|needs|reads|listens) (?:for |to )?[^.]{0,30}any ?more\b": "name the condition",
    r"\bsign of life\b": "heartbeat",
    r"\bis spent\b": "is used up",
    r"\bhow a fleet is cut\b": "how to split a fleet",
}
"""A regular expression for each habit, without regard to case, and what to write instead."""


def findings() -> Iterator[str]:
    """Yield each phrase found as `file:line: text (advice)`."""
    patterns = [(re.compile(pattern, re.IGNORECASE), advice) for pattern, advice in PHRASES.items()]
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60
    ).stdout
    for name in listed.splitlines():
        if not name.endswith(_SUFFIXES) or name == _HERE or not (ROOT / name).is_file():
            continue
        for number, line in enumerate((ROOT / name).read_text(encoding="utf-8").splitlines(), start=1):
            for pattern, advice in patterns:
                if found := pattern.search(line):
                    yield f"{name}:{number}: {found[0].strip()} ({advice})"


def main() -> int:
    """Print the findings; return the exit code."""
    found = list(findings())
    sys.stdout.write("\n".join([*found, f"prose: {len(found)} phrases to rewrite"]) + "\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
