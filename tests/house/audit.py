"""Audit the packages of this environment with pip-audit: `python -m tests.house.audit`, a part of `make check`.

Ends with 1 if a package has a known vulnerability. Where no vulnerability service can be reached, it says loudly that
nothing was audited, and ends with 0: a check that needs the internet must not stop who has none.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

LIMIT_S: Final = 180
_COMMAND: Final = ("-m", "pip_audit", "--format", "json", "--progress-spinner", "off", "--skip-editable")
_WIDTH: Final = 100


@dataclass(frozen=True)
class Verdict:
    """The result of an audit.

    Attributes:
        vulnerable: a line for each known vulnerability.
        audited: how many packages were looked up.
        unknown: those that could not be, with the reason.
    """

    vulnerable: tuple[str, ...]
    audited: int
    unknown: tuple[str, ...]


def judge(report: Mapping[str, Any]) -> Verdict:
    """Return what a report of pip-audit in JSON means. A package that it passed over was not audited."""
    vulnerable, unknown, audited = [], [], 0
    for package in report["dependencies"]:
        if "skip_reason" in package:
            if "distribution marked as editable" not in package["skip_reason"]:
                unknown.append(f"{package['name']}: {package['skip_reason']}")
            continue
        audited += 1
        for found in package["vulns"]:
            mended = ", ".join(found.get("fix_versions") or ()) or "none yet"
            vulnerable.append(f"{package['name']} {package['version']}: {found['id']}; mended in {mended}")
    return Verdict(tuple(vulnerable), audited, tuple(unknown))


def lines(verdict: Verdict) -> Iterable[str]:
    """Return the report for people."""
    yield from (f"vulnerable: {line}" for line in verdict.vulnerable)
    if not verdict.audited:
        yield from _banner(verdict.unknown[0] if verdict.unknown else "there are no packages")
        return
    yield from (f"not audited: {line}" for line in verdict.unknown)
    yield f"pip-audit: {len(verdict.vulnerable)} known vulnerabilities in {verdict.audited} packages"


def _banner(reason: str) -> Iterable[str]:
    yield "!" * _WIDTH
    yield "NOT AUDITED: no vulnerability service could be asked about any package. Run this again where one is reached."
    yield reason[: 3 * _WIDTH]
    yield "!" * _WIDTH


def main() -> int:
    """Audit this environment; return the exit code."""
    try:
        done = subprocess.run([sys.executable, *_COMMAND], capture_output=True, text=True, timeout=LIMIT_S)
        verdict = judge(json.loads(done.stdout))
    except subprocess.TimeoutExpired:
        verdict = Verdict((), 0, (f"pip-audit had no answer within {LIMIT_S} s",))
    except json.JSONDecodeError:  # it could not even begin
        said = done.stderr.strip().splitlines()
        if not any("onnect" in line or "esol" in line for line in said):
            sys.stderr.write(done.stderr)
            return 1
        verdict = Verdict((), 0, (said[-1],))
    sys.stdout.write("\n".join(lines(verdict)) + "\n")
    return 1 if verdict.vulnerable else 0


if __name__ == "__main__":
    sys.exit(main())
