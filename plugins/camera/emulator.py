"""A substitute for a camera: a folder of images, of a bar that moves to the right.

    python -m plugins.camera.emulator --folder

It prints the path for the plugin's `source`, with `loop: true`, and removes the folder on Ctrl-C or SIGTERM. In a
simulated world it is a network camera that shows what its robot sees.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import threading
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from .streaming import emulate_in_world

__all__ = ["PICTURES", "draw", "emulate_in_world"]

PICTURES: Final = 10
_HEIGHT: Final = 120
_WIDTH: Final = 160
_FLOOR: Final = (60, 60, 60)
_BAR: Final = (40, 160, 230)  # blue, green, red


def draw(folder: Path) -> None:
    """Write the pictures into a folder."""
    width = _WIDTH // PICTURES
    for number in range(PICTURES):
        picture = np.full((_HEIGHT, _WIDTH, 3), _FLOOR, dtype=np.uint8)
        picture[:, number * width : (number + 1) * width] = _BAR
        cv2.imwrite(str(folder / f"{number}.png"), picture)


def main(arguments: list[str] | None = None) -> None:
    """Provide a folder of pictures until a signal ends the program."""
    parser = argparse.ArgumentParser(prog="python -m plugins.camera.emulator", description="Pictures for a camera.")
    parser.add_argument(
        "--folder", action="store_true", required=True, help="create a folder of images; print its path"
    )
    parser.parse_args(arguments)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    with tempfile.TemporaryDirectory(prefix="eal-pictures-") as folder:
        draw(Path(folder))
        sys.stdout.write(f"{folder}\n")
        sys.stdout.flush()
        ended.wait()


if __name__ == "__main__":
    main()
