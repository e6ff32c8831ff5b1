"""The folder of a new run, and the picture that it gets when the run is over."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from eal_actors.device.world import WorldModel
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError, Problem, ScenarioError
from eal_actors.recording.picture import draw_trajectory
from eal_actors.recording.run_folder import RunFolder
from eal_actors.scenario.report.summary import Report

PICTURE = "trajectory.png"


def new_run_folder(runs_dir: Path, scenario: str) -> Path:
    """Make the folder of a run, named after its scenario and the time; one that is there already is left alone.

    Raises:
        ConfigError: it cannot be made.
    """
    name = f"{scenario}-{wall_time():%Y%m%dT%H%M%SZ}"
    number = 1
    while True:
        directory = runs_dir / (name if number == 1 else f"{name}-{number}")
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            raise ConfigError([Problem(str(directory), 0, 0, "", f"cannot be made: {error.strerror}")]) from error
        else:
            return directory


@contextmanager
def writing_into(directory: Path) -> Iterator[None]:
    """Say of a run's folder that it cannot be written, such as for a full disk.

    Raises:
        ScenarioError: it cannot.
    """
    try:
        yield
    except OSError as error:
        raise ScenarioError(f"the run's folder {directory} cannot be written: {error.strerror or error}") from error


def draw_run(run: RunFolder, report: Report, world: WorldModel | None) -> Path | None:
    """Draw where the robots were into the run's folder.

    Returns:
        The picture; None if no robot knew where it was, or matplotlib is missing, which is logged.

    Raises:
        ScenarioError: it cannot be written.
    """
    if not run.paths:
        return None
    title = f"{report.scenario} on {report.fleet}: {report.outcome}"
    outcomes = {name: robot.outcome for name, robot in report.robots.items()}
    with writing_into(run.path):
        return draw_trajectory(run.paths, world, run.path / PICTURE, title, outcomes, run.breaks_s)
