"""Cached build steps: keyed by the hash of their inputs, with atomic results."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from eal_actors.kernel.clock import REAL_TIME
from evbotos.errors import RESUME, BuildError, DiskFullError
from evbotos.hashing import tree_sha256


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a build.

    Attributes:
        name: the displayed name.
        key: the hash of everything that determines the result.
        make: creates the result, a file or folder, at the given path.
    """

    name: str
    key: str
    make: Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class StepDone:
    """The result of a step.

    Attributes:
        name: the displayed name.
        key: the hash of its inputs.
        seconds: its duration in this build.
        cached: whether the result came from the cache.
        made_s: how long its result took to make, in this build or an earlier one; None if not known.
    """

    name: str
    key: str
    seconds: float
    cached: bool
    made_s: float | None = None


@dataclass
class Runner:
    """Runs steps in a cache; an interrupted step leaves no result.

    Args:
        folder: the cache folder.
        tell: receives a step before it runs, with the seconds that it and the steps after it took the last time.
        names: the steps of the build, in their order.

    Attributes:
        done: the finished steps.
    """

    folder: Path
    tell: Callable[[str], None]
    names: Sequence[str] = ()
    done: list[StepDone] = field(default_factory=list)

    def outcome(self, step: Step) -> Path:
        """Return the cache path of a step's result."""
        return self.folder / step.name / step.key

    def run(self, step: Step) -> Path:
        """Return a step's result; run the step if the cache lacks it.

        Raises:
            BuildError: the step failed, for example because the disk is full.
        """
        outcome = self.outcome(step)
        start_s = REAL_TIME.now()
        cached = outcome.exists() and self._is_intact(step)
        if cached:
            os.utime(outcome)
        else:
            remove(outcome)
            self.tell(f"{step.name}{self._estimate(step.name)}")
            self._make(step, outcome)
            self._note_digest(step, tree_sha256(outcome))
        seconds = round(REAL_TIME.now() - start_s, 2)
        self.done.append(
            StepDone(step.name, step.key, seconds, cached, self._made_s(step, None if cached else seconds))
        )
        return outcome

    def _made_s(self, step: Step, seconds: float | None) -> float | None:
        """Note how long a step took, or return what was noted when it was made."""
        note = self.folder / "seconds" / f"{step.name}-{step.key}"
        if seconds is not None:
            note.parent.mkdir(exist_ok=True)
            note.write_text(f"{seconds}\n")
            return seconds
        return float(note.read_text()) if note.is_file() else None

    def _is_intact(self, step: Step) -> bool:
        """Return whether a result is as it was made: disks fail, and so does memory."""
        noted, found = self._digest(step), tree_sha256(self.outcome(step))
        if not noted.is_file():  # an earlier version made it
            self._note_digest(step, found)
        is_intact = noted.read_text() == found
        if not is_intact:
            self.tell(f"warning: {self.outcome(step)} has changed since it was made; it is made again")
        return is_intact

    def _digest(self, step: Step) -> Path:
        return self.folder / "digests" / f"{step.name}-{step.key}"

    def _note_digest(self, step: Step, digest: str) -> None:
        note = self._digest(step)
        note.parent.mkdir(exist_ok=True)
        note.write_text(digest)

    def _estimate(self, name: str) -> str:
        """Return a step's number, how long it took the last time, and how long those after it took."""
        place = self.names.index(name) + 1 if name in self.names else 0
        number = f", {place} of {len(self.names)}" if place else ""
        seconds = self._last_s(name)
        if seconds is None:
            return number
        rest = [self._last_s(later) for later in self.names[place:]] if place else []
        rest_s = sum(one for one in rest if one is not None)
        after = f"; at most about {rest_s:.0f} s for the rest" if rest and None not in rest else ""
        return f"{number} (about {seconds:.0f} s, as the last time{after})"

    def _last_s(self, name: str) -> float | None:
        notes = (note for note in (self.folder / "seconds").glob("*") if note.name.rpartition("-")[0] == name)
        newest = max(notes, key=lambda note: note.stat().st_mtime_ns, default=None)
        return None if newest is None else float(newest.read_text())

    def _make(self, step: Step, outcome: Path) -> None:
        part = outcome.with_name(f".part-{step.key}")
        outcome.parent.mkdir(parents=True, exist_ok=True)
        remove(part)
        try:
            step.make(part)
            part.rename(outcome)
        except OSError as error:
            if error.errno == errno.ENOSPC or os.strerror(errno.ENOSPC) in str(error):
                raise DiskFullError(f"step {step.name}: the disk of {self.folder} is full; {RESUME}") from error
            raise BuildError(f"step {step.name}: {_first_of(error)}") from error
        except BuildError as error:
            raise type(error)(f"step {step.name}: {error.message}") from error
        finally:
            remove(part)


def _first_of(error: OSError) -> str:
    """Return the first problem of many: copying a tree reports a list of them."""
    problems = error.args[0] if isinstance(error, shutil.Error) and error.args else None
    if not isinstance(problems, list):
        return str(error)
    source, _, why = problems[0]
    return f"{source}: {why}" + (f", and {len(problems) - 1} more" if len(problems) > 1 else "")


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Lock a cache during a `with` block, and remove the leftovers of killed builds.

    Raises:
        BuildError: another build uses it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BuildError(f"another build uses {folder}; wait until it ends") from None
        for part in [*folder.glob(".part-*"), *folder.glob("*/.part-*")]:
            remove(part)
        yield


def remove(path: Path) -> None:
    """Remove a file or folder if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def place(source: Path, target: Path) -> None:
    """Copy a file atomically; holes stay holes."""
    part = target.with_name(f".{target.name}.part")
    part.unlink(missing_ok=True)
    shutil.copyfile(source, part)
    part.replace(target)
