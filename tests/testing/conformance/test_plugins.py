"""Every shipped plugin passes every conformance check."""

from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.testing.conformance import CHECKS, Bench, Check, run_check, settings_of
from tests.recording.conftest import record_run
from tests.unit.plugins.camera.rig import write_folder

FOLDERS = sorted(manifest.parent for manifest in bundled_path("plugins").glob("*/plugin.yaml"))

PICTURES, RECORD = "pictures", "record"
"""Stand for a folder of images and for the folder of a run, which fixtures of these names make."""

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
    pytest.param(folder, settings, id="-".join([folder.name, *map(str, settings.values())]))
    for folder in FOLDERS
    for settings in SETTINGS.get(folder.name, [{}])
]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Make a folder of images."""
    return str(write_folder(tmp_path_factory.mktemp("pictures"), range(10)))


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Record a run."""
    return str(record_run(tmp_path_factory.mktemp("record") / "one" / "run", "all"))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize(("folder", "settings"), CASES)
def test_it_conforms(folder: Path, settings: dict[str, Any], check: Check, request: pytest.FixtureRequest) -> None:
    made = {value: request.getfixturevalue(value) for value in (PICTURES, RECORD) if value in settings.values()}
    settings = {key: made.get(value, value) if isinstance(value, str) else value for key, value in settings.items()}
    result = run_check(check, Bench(folder, settings_of(settings), timeout_s=CALL_S))
    assert result.outcome != "failed", "\n".join([check.description, *result.problems])


def test_the_simulation_leaves_no_check_out() -> None:
    bench = Bench(bundled_path("plugins/sim"), settings_of({"model": "roomba"}))
    assert [check.name for check in CHECKS if run_check(check, bench).outcome == "skipped"] == [
        "waits for its device",  # it has none
        "survives unplugging",
    ]
