"""The tests under every Python that the project supports, each in an environment of its own: `nox`, `nox -s package`.

A Python that is not installed is skipped, and nox says so; `nox --error-on-missing-interpreters` makes that a failure.
"""

from __future__ import annotations

import nox

PYTHONS = ("3.11", "3.12", "3.13", "3.14")
EXTRAS = "sim,vision,record,system,dashboard,evbotos,metrics,top"

nox.options.sessions = ["tests"]
nox.options.error_on_missing_interpreters = False
nox.needs_version = ">=2025.2"


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Run every test, or those that are named after `--`."""
    session.install("--editable", f".[{EXTRAS}]", *nox.project.dependency_groups(_project(), "dev"))
    session.run("python", "-m", "pytest", *(session.posargs or ("-n", "auto", "--dist", "loadfile")))


@nox.session(python=PYTHONS)
def package(session: nox.Session) -> None:
    """Install the package alone, away from its source, and run what its first page promises."""
    session.install(".[sim,record]")
    session.cd(session.create_tmp())
    session.run("eal", "run", "dance", "--fleet", "sim", "--rate", "max")


def _project() -> dict[str, object]:
    return nox.project.load_toml("pyproject.toml")
