"""Steps with inputs: done once, kept under the hash of what went in, and whole or not there at all."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from eal_actors.kernel.clock import REAL_TIME
from evbotos.errors import BuildError


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a build.

    Attributes:
        name: as it is shown.
        key: of all that decides its outcome.
        make: makes the outcome, a file or a folder, at the path that it is given.
    """

    name: str
    key: str
    make: Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class StepDone:
    """How a step went.

    Attributes:
        name: as it is shown.
        key: of its inputs.
        seconds: that it took now.
        cached: whether it was there already.
    """

    name: str
    key: str
    seconds: float
    cached: bool


@dataclass
class Runner:
    """Runs steps in a cache, where an interrupted one leaves nothing behind that counts.

    Args:
        folder: the cache.
        tell: told of a step before it is made.

    Attributes:
        done: the steps so far.
    """

    folder: Path
    tell: Callable[[str], None]
    done: list[StepDone] = field(default_factory=list)

    def outcome(self, step: Step) -> Path:
        """Return where the outcome of a step is kept."""
        return self.folder / step.name / step.key

    def run(self, step: Step) -> Path:
        """Return a step's outcome; makes it if it is not there.

        Raises:
            BuildError: it cannot be made; the disk may be full.
        """
        outcome = self.outcome(step)
        start_s = REAL_TIME.now()
        cached = outcome.exists()
        if cached:
            os.utime(outcome)
        else:
            self.tell(step.name)
            self._make(step, outcome)
        self.done.append(StepDone(step.name, step.key, round(REAL_TIME.now() - start_s, 2), cached))
        return outcome

    def _make(self, step: Step, outcome: Path) -> None:
        part = outcome.with_name(f".part-{step.key}")
        outcome.parent.mkdir(parents=True, exist_ok=True)
        remove(part)
        try:
            step.make(part)
            part.rename(outcome)
        except OSError as error:
            raise BuildError(f"step {step.name}: {error}") from error
        except BuildError as error:
            raise type(error)(f"step {step.name}: {error.message}") from error
        finally:
            remove(part)


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Own a cache for the length of a `with` block, and clear away what killed builds left in it.

    Raises:
        BuildError: another build is at work in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BuildError(f"another build is at work in {folder}; wait for its end") from None
        for part in [*folder.glob(".part-*"), *folder.glob("*/.part-*")]:
            remove(part)
        yield


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def place(source: Path, target: Path) -> None:
    """Put a copy of a file in its place at once: no reader ever sees half of it. Holes stay holes."""
    part = target.with_name(f".{target.name}.part")
    part.unlink(missing_ok=True)
    shutil.copyfile(source, part)
    part.replace(target)
