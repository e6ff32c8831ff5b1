"""Checks of Python and of the installed packages against the framework's requirements."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem

DISTRIBUTION: Final = "eal-actors"

_AREA: Final = "packages"
_REQUIREMENT: Final = re.compile(r"([A-Za-z0-9._-]+)\s*(?:\[[^\]]*\])?\s*([^;]*)(?:;(.*))?")
_BOUND: Final = re.compile(r"(>=|<)\s*([0-9][0-9.]*)")


def check_packages() -> Iterator[Diagnostic]:
    """Yield diagnostics of Python and of the installed packages."""
    metadata = importlib.metadata.metadata(DISTRIBUTION)
    yield judge_python(sys.version_info[:3], metadata["Requires-Python"] or "")
    requirements = importlib.metadata.requires(DISTRIBUTION) or []
    versions = {_normalize(found.name): found.version for found in importlib.metadata.distributions() if found.name}
    yield from judge_requirements(requirements, versions)


def judge_python(version: tuple[int, ...], required: str) -> Diagnostic:
    """Return the diagnostic of a version of Python, such as (3, 11, 9), by a requirement such as `>=3.11`."""
    text = ".".join(map(str, version))
    if _fits(text, required):
        return ok("python", f"Python {text} on {platform.system()} {platform.machine()}")
    return problem("python", f"Python {text} is not {required}", f"Install Python {required}, and eal-actors in it.")


def judge_requirements(requirements: Iterable[str], installed: Mapping[str, str]) -> Iterator[Diagnostic]:
    """Yield problems with the packages that every installation needs, or a single good result.

    Names are in lower case with hyphens; requirements of extras are ignored.
    """
    fitting, wrong = [], []
    for requirement in requirements:
        match = _REQUIREMENT.match(requirement)
        if match is None or "extra" in (match[3] or ""):
            continue
        name, wanted = match[1], match[2].strip()
        version = installed.get(_normalize(name))
        if version is not None and _fits(version, wanted):
            fitting.append(f"{name} {version}")
            continue
        what = f"{name} is not installed" if version is None else f"{name} is {version}, not {wanted}"
        wrong.append(problem(_AREA, what, f"pip install '{name}{wanted}'"))
    yield from wrong
    if not wrong:
        yield ok(_AREA, ", ".join(fitting))


def _normalize(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _fits(version: str, wanted: str) -> bool:
    """Return whether a version is within bounds such as `>=4.5,<5`. Suffixes such as `rc1` are ignored."""
    have = _release_numbers(version)
    for sign, bound in _BOUND.findall(wanted):
        limit = _release_numbers(bound)
        size = max(len(have), len(limit))
        left, right = (numbers + (0,) * (size - len(numbers)) for numbers in (have, limit))
        if (left < right) if sign == ">=" else (left >= right):
            return False
    return True


def _release_numbers(version: str) -> tuple[int, ...]:
    match = re.match(r"\d+(\.\d+)*", version)
    return tuple(map(int, match[0].split("."))) if match is not None else (0,)
