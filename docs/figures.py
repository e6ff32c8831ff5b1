"""Make the pictures of the documentation: `make figures`. They repeat, for all of them come from `rate: max`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from eal_actors.recording import PoseRecorder, draw_trajectory, draw_world
from eal_actors.scenario import run_scenario
from eal_actors.testing import Simulation
from eal_actors.world import load_world

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
    robots = {
        model: {"model": model, "start": (x_m, 0.0, 0)}
        for model, x_m in (("evbot2", -1.5), ("evbot3", 0.0), ("roomba", 1.5))
    }
    draw_run("dance.yaml", robots, "the dance", out)


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


def main() -> None:
    """Make every picture."""
    IMAGES.mkdir(exist_ok=True)
    draw_square(IMAGES / "square.png")
    draw_dance(IMAGES / "dance.png")
    draw_view(IMAGES / "lab-view.png")
    draw_world(load_world(ROOT / "fleets/worlds/lab.yaml"), IMAGES / "lab.png")
    draw_world(load_world(ROOT / "fleets/worlds/maze.yaml"), IMAGES / "maze.png")


if __name__ == "__main__":
    main()
