"""Turn in place and take pictures (Source: thesis table 6.2).

Usage: EAL_FLEET=sim camera.py HOST PORT [FOLDER]
"""

import sys
from pathlib import Path
from typing import Any

import cv2

from eal_actors.classic import EALconnect, EALdisconnect


def saveFrame(frame: Any, name: Path, i: int) -> bool:  # noqa: N802
    """Save an RGB frame as `NAME.<i>.jpg`; return whether it was written."""
    return bool(cv2.imwrite(f"{name}.{i}.jpg", frame[..., ::-1]))  # OpenCV wants blue first


def main(argv: list[str]) -> int:
    """Return 0; 1 when a call failed; 2 for a wrong command line."""
    if len(argv) < 3:
        print(__doc__, file=sys.stderr)
        return 2
    folder = Path(argv[3] if len(argv) > 3 else "/tmp")  # noqa: S108  # as in the thesis

    client = EALconnect(argv[1], int(argv[2]))
    if client is None:
        print("Error connecting to EAL", file=sys.stderr)
        return 1

    baseId = client.findResource("Base")
    cameraId = client.findResource("Camera")

    failures = 0
    for i in range(7):
        turned = client.sendCmd(baseId, "r45", None)
        frame = client.getValue(cameraId)
        if turned < 0 or frame is None or not saveFrame(frame.data, folder / "frame", i):
            print(f"No picture {i}", file=sys.stderr)
            failures += 1

    EALdisconnect(client)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
