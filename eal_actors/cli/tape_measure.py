"""A person with a tape measure, who is asked on the terminal where a robot came to stand."""

from __future__ import annotations

import math
import sys

import typer

from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.calibration.square import Way
from eal_actors.lab.calibration.umbmark import Point

_WAYS = {"cw": "clockwise", "ccw": "counter-clockwise"}


class Person:
    """Measures a real robot, and carries it back to its mark.

    Args:
        robot: the robot's name.
        clock: the fleet's clock, which must not wait for the person.
    """

    def __init__(self, robot: str, clock: Clock) -> None:
        self._robot = robot
        self._clock = clock

    def begin(self, way: Way, number: int) -> None:
        """See Measurer; raises ArgumentError if nobody is there to be asked."""
        self._ask(f"{self._robot}, square {number} {_WAYS[way]}: put it on its mark, clear the floor, press Enter:")

    def end(self, way: Way, number: int) -> Point:
        """See Measurer; raises ArgumentError if nobody is there to be asked."""
        while True:
            text = self._ask(f"{self._robot}, square {number} {_WAYS[way]}: mm ahead and mm left of the mark?")
            try:
                x_mm, y_mm = map(float, text.replace(",", " ").split())
            except ValueError:
                x_mm = y_mm = math.nan
            if math.isfinite(x_mm) and math.isfinite(y_mm):
                return x_mm / 1000, y_mm / 1000
            typer.echo("Two numbers, such as: -12 35", err=True)

    def _ask(self, question: str) -> str:
        typer.echo(f"{question} ", nl=False, err=True)
        with self._clock.outside():
            answer = sys.stdin.readline()
        if not answer:
            raise ArgumentError(
                f"nobody says where {self._robot} came to stand: run it on a terminal, or name a file with --ends"
            )
        return answer.strip()
