"""Every shipped plugin passes every conformance check."""

from pathlib import Path
from typing import Any

import cv2
import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.testing.conformance import CHECKS, Bench, Check, run_check, settings_of
from tests.recording.conftest import record_run
from tests.unit.plugins.camera.rig import write_folder
from tests.unit.plugins.tracker.pictures import DISTORTION, FLOOR, MATRIX, SIZE, Mark, draw

ELSEWHERE = ("mavlink", "mqtt", "ros2", "vda5050")
"""Plugins that need a robot of others: tests/unit/plugins/{ros2,vda5050}/test_conformance.py."""

FOLDERS = sorted(
    manifest.parent
    for manifest in bundled_path("plugins").glob("*/plugin.yaml")
    if manifest.parent.name not in ELSEWHERE
)

PICTURES, RECORD, OVERHEAD = "pictures", "record", "overhead"
"""Stand for folders of images, and for the folder of a run, which fixtures of these names make."""

ROBOT = Mark(7, 0.2, 0.1, z_m=0.15)

CALL_S = 15.0
"""Deadline of a call: the first frame of a simulated camera takes its time on a busy machine."""

SETTINGS: dict[str, list[dict[str, Any]]] = {
    "sim": [
        {"model": "evbot2"},
        {"model": "evbot3", "lidar": {}, "imu": {}, "depth_camera": {}},
        {"model": "roomba"},
    ],
    "replay": [{"record": RECORD, "robot": "evbot2-1", "loop": True}],  # every value follows the record
    "camera": [{"source": PICTURES, "loop": True, "fps": 50, "fov_deg": 60}],
    "tracker": [
        {
            "cameras": {
                "ceiling": {
                    "source": OVERHEAD,
                    "loop": True,
                    "lens": {
                        "size_px": list(SIZE),
                        "focal_px": [float(MATRIX[0, 0]), float(MATRIX[1, 1])],
                        "centre_px": [float(MATRIX[0, 2]), float(MATRIX[1, 2])],
                        "distortion": DISTORTION.tolist(),
                    },
                }
            },
            "markers": [{"ids": [ROBOT.number], "size_m": ROBOT.size_m, "height_m": ROBOT.z_m}],
            "floor": [{"id": mark.number, "x_m": mark.x_m, "y_m": mark.y_m, "size_m": mark.size_m} for mark in FLOOR],
        }
    ],
    "socket_port": [{}, {"protocol": "udp", "host": "127.0.0.1", "port": 9}],
    "evbot2": [{}, {"port": "sim://world"}],  # without settings, an emulator replaces the robot
    "evbot3": [{}, {"address": "sim://world"}],
    "roomba": [
        {"protocol": "sci", "port": "sim://world", "poll_hz": 5},
        {"protocol": "sci", "poll_hz": 5},
        {"protocol": "sci", "link": "mote", "poll_hz": 5},
        {"protocol": "oi", "port": "sim://world", "poll_hz": 5},
        {"protocol": "oi", "poll_hz": 5},
    ],
}
"""Settings of the plugins that need some; each is checked."""

CASES = [
    pytest.param(
        folder,
        settings,
        id="-".join([folder.name, *(str(part) for part in settings.values() if isinstance(part, str | int | bool))]),
    )
    for folder in FOLDERS
    for settings in SETTINGS.get(folder.name, [{}])
]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Make a folder of images."""
    return str(write_folder(tmp_path_factory.mktemp("pictures"), range(10)))


@pytest.fixture(scope="module")
def overhead(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Make a folder of pictures of a floor with markers."""
    folder = tmp_path_factory.mktemp("overhead")
    for number in range(3):
        cv2.imwrite(str(folder / f"{number}.png"), draw((*FLOOR, ROBOT), seed=number))
    return str(folder)


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Record a run."""
    return str(record_run(tmp_path_factory.mktemp("record") / "one" / "run", "all"))


def with_folders(settings: Any, request: pytest.FixtureRequest) -> Any:
    """Return settings with the folders that their names stand for."""
    if isinstance(settings, dict):
        return {key: with_folders(value, request) for key, value in settings.items()}
    return request.getfixturevalue(settings) if settings in (PICTURES, RECORD, OVERHEAD) else settings


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize(("folder", "settings"), CASES)
def test_it_conforms(folder: Path, settings: dict[str, Any], check: Check, request: pytest.FixtureRequest) -> None:
    settings = with_folders(settings, request)
    result = run_check(check, Bench(folder, settings_of(settings), timeout_s=CALL_S))
    assert result.outcome != "failed", "\n".join([check.description, *result.problems])


@pytest.mark.slow
def test_the_simulation_leaves_no_check_out() -> None:
    bench = Bench(bundled_path("plugins/sim"), settings_of({"model": "roomba"}))
    assert [check.name for check in CHECKS if run_check(check, bench).outcome == "skipped"] == [
        "waits for its device",  # it has none
        "survives unplugging",
    ]
