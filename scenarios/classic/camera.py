"""Turn in place and take pictures (Source: thesis table 6.2).

Usage: EAL_FLEET=fleets/sim.yaml camera.py HOST PORT [FOLDER]
"""

import sys
from pathlib import Path
from typing import Any

from eal_actors.classic import EALconnect, EALdisconnect


def saveFrame(frame: Any, name: Path, i: int) -> None:  # noqa: N802
    """Save a frame as `NAME.<i>.png`, or as `.npy` where OpenCV is missing."""
    try:
        import cv2
    except ImportError:
        import numpy as np

        np.save(f"{name}.{i}.npy", frame)
    else:
        cv2.imwrite(f"{name}.{i}.png", frame)


def main(argv: list[str]) -> int:
    """Return 0, or 1 when there is no connection."""
    if len(argv) < 3:
        return 0
    folder = Path(argv[3] if len(argv) > 3 else ".")

    client = EALconnect(argv[1], int(argv[2]))
    if client is None:
        print("Error connecting to EAL")
        return 1

    baseId = client.findResource("Base")
    cameraId = client.findResource("Camera")

    for i in range(7):
        client.sendCmd(baseId, "r45", None)
        frame = client.getValue(cameraId)
        if frame:
            saveFrame(frame.data, folder / "frame", i)

    EALdisconnect(client)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
