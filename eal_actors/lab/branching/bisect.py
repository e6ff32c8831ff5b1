"""Bisection: the version of the scenario, or of the framework, at which the record of a run first differs."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from eal_actors.kernel.errors import ScenarioError
from eal_actors.lab.branching.past import read_input
from eal_actors.recording import Difference, RunFolder, first_difference
from eal_actors.recording.provenance import FLEET

_GIT_S: Final = 60.0
_RUN_S: Final = 3600.0
_PACKAGE: Final = "eal_actors"

OnVersion = Callable[[str, bool], None]
"""Receives each tried version, and whether its record is the same."""


@dataclass(frozen=True, slots=True)
class Bisection:
    """The result: the first version that differs, a commit with its title or a file; `first` is None without one."""

    version: str
    first: Difference | None
    tried: int


def bisect(run: Path, good: str, bad: str, on_version: OnVersion = lambda _version, _same: None) -> Bisection:
    """Find the first version whose record of a run differs from that of a good version.

    Versions are two scenario files, or two revisions of the git repository in the working directory, which has the
    scenario of the run at the same path, or is the framework's own. Nothing in the repository is changed. A bad
    revision descends from the good one. `on_version` is called after each run. Raises ScenarioError if the run cannot
    be repeated, or the versions cannot be compared.

    Thread: blocks the caller.
    """
    with TemporaryDirectory(prefix="eal-bisect-") as folder:
        versions = _Versions(run, Path(folder))
        if Path(good).is_file() and Path(bad).is_file():
            return versions.compare_files(good, bad, on_version)
        return versions.search(_commits(good, bad), on_version)


def _commits(good: str, bad: str) -> list[str]:
    """Return the commits from the good one to the bad one, the oldest first."""
    newer = _git("rev-list", "--reverse", "--ancestry-path", f"{good}..{bad}").split()
    if not newer:
        raise ScenarioError(f"{bad} does not descend from {good}: there is no commit between them")
    return [_git("rev-parse", good).strip(), *newer]


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", *arguments], capture_output=True, text=True, timeout=_GIT_S, check=False)  # noqa: S603, S607  # the user's own git
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ScenarioError(f"git {arguments[0]}: {error}") from error
    if done.returncode:
        raise ScenarioError(f"git {arguments[0]}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout


def _archived(file: Path, top: Path, root: Path) -> Path | None:
    """Return a file of the repository in the folder with one of its commits; None if it is not in the repository."""
    found = file.resolve()
    return root / found.relative_to(top) if found.is_relative_to(top) else None


class _Versions:
    """Runs versions, and compares their records."""

    def __init__(self, run: Path, folder: Path) -> None:
        self._past = read_input(run)
        self._steps = [self._past.config.source.parent] if self._past.config.python_steps else []
        self._run = run
        self._folder = folder
        self._made: dict[str, RunFolder] = {}

    def compare_files(self, good: str, bad: str, on_version: OnVersion) -> Bisection:
        one, other = (self._record(name, Path(name), self._steps) for name in (good, bad))
        first = first_difference(one, other)
        on_version(bad, first is None)
        return Bisection(bad, first, 2)

    def search(self, commits: Sequence[str], on_version: OnVersion) -> Bisection:
        """Return the first commit that differs from the first one, by halves."""
        low, high = 0, len(commits) - 1
        first = self._differs(commits, high, on_version)
        if first is None:
            return Bisection(commits[high], None, len(self._made))
        while high - low > 1:
            middle = (low + high) // 2
            found = self._differs(commits, middle, on_version)
            if found is None:
                low = middle
            else:
                high, first = middle, found
        title = _git("log", "-1", "--format=%h %s", commits[high]).strip()
        return Bisection(title, first, len(self._made))

    def _differs(self, commits: Sequence[str], number: int, on_version: OnVersion) -> Difference | None:
        first = first_difference(self._of_commit(commits[0]), self._of_commit(commits[number]))
        on_version(commits[number][:12], first is None)
        return first

    def _of_commit(self, commit: str) -> RunFolder:
        if commit in self._made:
            return self._made[commit]
        root = self._folder / commit
        root.mkdir()
        top = Path(_git("rev-parse", "--show-toplevel").strip())
        archive = subprocess.run(["git", "archive", commit], capture_output=True, timeout=_GIT_S, check=False, cwd=top)  # noqa: S603, S607  # the user's own git
        if archive.returncode:
            raise ScenarioError(f"git archive: {archive.stderr.decode(errors='replace').strip()}")
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
            files.extractall(root, filter="data")
        scenario = _archived(Path(self._past.report.scenario_file), top, root) or self._past.scenario.source
        framework = [root] if (root / _PACKAGE / "__main__.py").is_file() else []
        if framework and not scenario.is_file():
            scenario = self._past.scenario.source
        steps = [_archived(folder, top, root) or folder for folder in self._steps]
        made = self._record(commit, scenario, [*framework, *steps])
        shutil.rmtree(root)
        return made

    def _record(self, name: str, scenario: Path, modules: Sequence[Path]) -> RunFolder:
        """Run a version in a process of its own, and return its record; `modules` are folders to import from."""
        if not scenario.is_file():
            raise ScenarioError(f"{name} has no scenario {scenario.name}")
        runs = self._folder / f"runs-{len(self._made)}"
        parameters = self._past.report.parameters.items()
        given = [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in parameters]
        bound = [f"{role}={','.join(names)}" for role, names in self._past.binding.items() if names]
        words = ["run", str(scenario), "--fleet", str(self._run / FLEET), "--rate", "max", "--no-plot"]
        words += ["--runs-dir", str(runs), *(word for text in given for word in ("--set", text))]
        words += [word for text in bound for word in ("--bind", text)]
        path = os.pathsep.join([*(str(folder.resolve()) for folder in modules), os.environ.get("PYTHONPATH", "")])
        environment = {**os.environ, "PYTHONPATH": path.removesuffix(os.pathsep)}
        command = [sys.executable, "-P", "-m", _PACKAGE, *words]  # -P: the framework is not the one in this directory
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_RUN_S, env=environment, check=False)  # noqa: S603  # this program
        except subprocess.TimeoutExpired as error:
            raise ScenarioError(f"the run of {name} took more than {_RUN_S:g} s") from error
        made = next(iter(runs.iterdir()), None) if runs.is_dir() else None
        if made is None:
            raise ScenarioError(f"the run of {name} did not start: {done.stderr.strip() or done.stdout.strip()}")
        self._made[name] = RunFolder.open(made)
        return self._made[name]
