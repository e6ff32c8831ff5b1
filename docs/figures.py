"""Make the pictures of the documentation: `make figures`. They repeat, for all of them come from `rate: max`."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import cv2
import numpy as np
from dashboard_figures import draw_dashboard
from swap_figure import draw_swap

from eal_actors import Fleet, RobotHandle, gather
from eal_actors.device.world import load_world
from eal_actors.lab.calibration.drive import GroundTruth, calibrate_base, drive_squares, wheelbase_of
from eal_actors.lab.calibration.fit import fit_squares
from eal_actors.lab.calibration.square import WAYS, SquareEnds
from eal_actors.recording import PoseRecorder, draw_trajectory, draw_world
from eal_actors.recording.arena import draw_grid, new_figure
from eal_actors.scenario import run_scenario
from eal_actors.testing import Simulation

ROOT: Final = Path(__file__).parents[1]
IMAGES: Final = ROOT / "docs/images"
SEED: Final = 7


def draw_run(
    scenario: str, robots: Mapping[str, Mapping[str, Any]], title: str, out: Path, step_m: float = 0.5
) -> None:
    """Run a shipped scenario in an empty room, and draw where the robots went."""
    with Simulation(robots, "empty", seed=SEED) as simulation:
        for name in robots:
            simulation[name]["Base"].set_config("step_m", step_m).get()
        start_s = simulation.now_s
        with PoseRecorder(simulation.fleet, robots) as recorder:
            report = run_scenario(ROOT / "scenarios" / scenario, simulation.fleet)
        if report.outcome != "done":
            raise RuntimeError(f"{scenario}: {report.error}")
        draw_trajectory(recorder.paths_since(start_s), simulation.fleet.config.world, out, title)


def draw_square(out: Path) -> None:
    """Draw the thesis's square, forward and back, as bases do it that nobody has calibrated (thesis figure 6.4)."""
    robots = {
        model: {"model": model, "calibrated": False, "start": (x_m, 0.5, 0)}
        for model, x_m in (("evbot2", -2.3), ("evbot3", -0.4), ("roomba", 1.5))
    }
    draw_run("square.yaml", robots, "the square, forward and back, uncalibrated", out, step_m=1.0)


def draw_dance(out: Path) -> None:
    """Draw the dance of the shipped fleet."""
    draw_shipped("dance", "the dance", out, fleet="sim")


def draw_view(out: Path) -> None:
    """Draw what a camera sees of the laboratory and of three other robots."""
    robots: dict[str, Mapping[str, Any]] = {
        "eye": {"model": "evbot3", "start": (-0.6, -0.9, 42)},
        "a": {"model": "evbot2", "start": (0.4, 0.3, 200)},
        "b": {"model": "roomba", "start": (1.15, 0.1, 150)},
        "c": {"model": "evbot3", "start": (1.0, 1.2, 250)},
    }
    with Simulation(robots, "lab", seed=SEED) as simulation:
        frame = np.asarray(simulation["eye"]["Camera"].get_value().get().value)
    cv2.imwrite(str(out), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))


def draw_calibration(out: Path) -> None:
    """Draw where squares of 1 m end before and after a calibration, as in the paper on UMBmark."""
    fleet = Fleet.load(ROOT / "fleets/uncalibrated.yaml")
    figure = new_figure(11, 4.4)
    if figure is None:
        raise RuntimeError("matplotlib is missing")
    with fleet.connect():
        for axes, robot in zip(figure.subplots(1, len(fleet)), fleet.values(), strict=True):
            before, after = _calibrated(robot)
            for ends, colour, when in ((before, "#c0392b", "before"), (after, "#1f77b4", "after")):
                for way, marker in zip(WAYS, "os", strict=True):
                    x_mm, y_mm = (1000 * np.array(list(ends.of(way)))).T
                    axes.plot(x_mm, y_mm, marker, mfc="none", color=colour, ms=5, label=f"{when}, {way}")
                    axes.plot(x_mm.mean(), y_mm.mean(), "+", color=colour, ms=14)
            axes.plot(0, 0, "x", color="black", ms=9, label="start")
            axes.set_aspect("equal", "datalim")
            axes.set_xlabel("x, ahead [mm]")
            draw_grid(axes)
            axes.set_title(f"{robot.type}: {before.error_m * 1000:.0f} mm, then {after.error_m * 1000:.0f} mm")
    figure.axes[0].set_ylabel("y, to the left [mm]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(out, metadata={"Software": None})


def _calibrated(robot: RobotHandle) -> tuple[SquareEnds, SquareEnds]:
    """Calibrate a robot; return where five squares each way ended before and after."""
    truth, wheelbase_m = GroundTruth(robot), wheelbase_of(robot)
    if wheelbase_m is None:
        raise RuntimeError(f"{robot.name} tells no wheelbase")
    before = drive_squares(robot, truth, 1.0, 5)
    calibrate_base(robot, fit_squares(before, 1.0, wheelbase_m).calibration)
    return before, drive_squares(robot, truth, 1.0, 5)


def draw_panorama(out: Path) -> None:
    """Draw what a robot's eight frames of the laboratory become, at half size."""
    robots = {"eye": {"model": "evbot2", "start": (0.3, -0.2, 0)}}
    with Simulation(robots, "lab", seed=SEED) as simulation:
        draw_picture_of(simulation, "panorama", "eye/panorama.png", out)


def draw_picture_of(simulation: Simulation, scenario: str, picture: str, out: Path) -> None:
    """Run a shipped scenario, and draw a picture that it writes, at half size."""
    with TemporaryDirectory() as folder:
        report = run_scenario(ROOT / f"scenarios/{scenario}.yaml", simulation.fleet, directory=Path(folder))
        image = cv2.imread(f"{folder}/{picture}")
    if report.outcome != "done" or image is None:
        raise RuntimeError(f"{scenario}: {report.error or 'no picture'}")
    cv2.imwrite(str(out), cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def draw_survey(out: Path) -> None:
    """Draw what a lidar meets in the laboratory."""
    command = [ROOT / "scenarios/survey.py", "--fleet", ROOT / "fleets/survey.yaml", "--out", out]
    subprocess.run([sys.executable, *map(str, command)], check=True, cwd=ROOT)  # noqa: S603


def draw_shipped(name: str, title: str, out: Path, fleet: str | None = None) -> None:
    """Run a shipped scenario on the fleet of its name, or on another, and draw where the robots went."""
    with Simulation(ROOT / f"fleets/{fleet or name}.yaml") as simulation:
        with PoseRecorder(simulation.fleet, list(simulation.fleet)) as recorder:
            report = run_scenario(ROOT / f"scenarios/{name}.yaml", simulation.fleet)
        if report.outcome != "done":
            raise RuntimeError(f"{name}: {report.error}")
        draw_trajectory(recorder.paths_since(0), simulation.fleet.config.world, out, title)


def draw_ballet(out: Path) -> None:
    """Film the scenario of `make demo`."""
    with TemporaryDirectory() as folder:
        command = ["run", "ballet", "--fleet", "formation", "--rate", "max", "--film", "--runs-dir", folder]
        subprocess.run([sys.executable, "-m", "eal_actors", *command], check=True, cwd=ROOT)  # noqa: S603
        (film,) = Path(folder).glob("*/trajectory.gif")
        shutil.copyfile(film, out)


def draw_patrol(out: Path) -> None:
    """Draw what a guard saw at one place in two laps, and what has changed there, at half size."""
    with Simulation(ROOT / "fleets/patrol.yaml") as simulation:
        draw_picture_of(simulation, "patrol-visit", "evbot3-2/changed.1.northeast.png", out)


def draw_sweep(out: Path) -> None:
    """Draw what the sweep of its page comes to."""
    page = (ROOT / "docs/sweeps.md").read_text(encoding="utf-8")
    scenario = page.partition("```yaml\n")[2].partition("```")[0]
    vary = ("--vary", "side_m=0.25:1:0.25", "--vary", "turn=left,right", "--seeds", "1:10")
    with TemporaryDirectory() as folder:
        file, swept = Path(folder) / "sides.yaml", Path(folder) / "out"
        file.write_text(scenario, encoding="utf-8")
        command = ["sweep", file, "--fleet", ROOT / "fleets/sim.yaml", *vary, "--out", swept]
        subprocess.run([sys.executable, "-m", "eal_actors", *map(str, command)], check=True, cwd=ROOT)  # noqa: S603
        shutil.copyfile(swept / "table.png", out)


def draw_arena(out: Path) -> None:
    """Draw what the camera above the arena sees, after some robots have turned."""
    with Fleet.load(ROOT / "fleets/arena.yaml") as fleet:
        gather([fleet[name]["Base"].send_cmd("l30") for name in fleet if name != "cameras-1"]).get()
        picture = fleet["cameras-1"]["Picture"].get_value().get().value
    small = cv2.resize(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), (880, 660), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(out), small, [cv2.IMWRITE_JPEG_QUALITY, 85])


def main() -> None:
    """Make every picture."""
    IMAGES.mkdir(exist_ok=True)
    draw_square(IMAGES / "square.png")
    draw_dance(IMAGES / "dance.png")
    draw_view(IMAGES / "lab-view.png")
    draw_arena(IMAGES / "arena.jpg")
    draw_panorama(IMAGES / "panorama.png")
    draw_survey(IMAGES / "survey.png")
    draw_calibration(IMAGES / "calibration.png")
    draw_sweep(IMAGES / "sweep.png")
    draw_shipped("formation", "formation: a circle", IMAGES / "formation.png")
    draw_ballet(IMAGES / "ballet.gif")
    draw_patrol(IMAGES / "patrol.png")
    draw_shipped("search", "search: the first to hear the beacon stops the rest", IMAGES / "search.png")
    draw_shipped("relay", "relay: two laps with three batteries", IMAGES / "relay.png")
    draw_world(load_world(ROOT / "fleets/worlds/lab.yaml"), IMAGES / "lab.png")
    draw_world(load_world(ROOT / "fleets/worlds/maze.yaml"), IMAGES / "maze.png")
    draw_swap(IMAGES)
    draw_dashboard()


if __name__ == "__main__":
    main()
