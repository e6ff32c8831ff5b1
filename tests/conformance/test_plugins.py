"""Every plugin that is shipped passes every check that a plugin's author can run."""

from pathlib import Path
from typing import Any

import pytest

from eal_actors.bundled import bundled_path
from eal_actors.conformance import CHECKS, Bench, Check, run_check, settings_of

FOLDERS = sorted(manifest.parent for manifest in bundled_path("plugins").glob("*/plugin.yaml"))

SETTINGS: dict[str, list[dict[str, Any]]] = {
    "sim": [{"model": make} for make in ("evbot2", "evbot3", "roomba")],
    "mote_roomba": [{"port": "sim://world", "poll_hz": 5}],
}
"""For plugins that cannot do without: each of these is checked."""

CASES = [
    pytest.param(folder, settings, id="-".join([folder.name, *map(str, settings.values())]))
    for folder in FOLDERS
    for settings in SETTINGS.get(folder.name, [{}])
]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize(("folder", "settings"), CASES)
def test_it_conforms(folder: Path, settings: dict[str, Any], check: Check) -> None:
    result = run_check(check, Bench(folder, settings_of(settings)))
    assert result.outcome != "failed", "\n".join([check.description, *result.problems])


def test_the_simulation_leaves_no_check_out() -> None:
    bench = Bench(bundled_path("plugins/sim"), settings_of({"model": "roomba"}))
    assert [check.name for check in CHECKS if run_check(check, bench).outcome == "skipped"] == []
