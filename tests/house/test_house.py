"""The rules of the house: format, lint, types, layers. The same commands as `make check`.

Types are checked there and in the long suite only, because mypy computes for a minute.
"""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from tests.house import javascript

ROOT = Path(__file__).parents[2]
SCRIPTS = Path(sysconfig.get_path("scripts"))


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(["ruff", "format", "--check", "."], id="format"),
        pytest.param(["ruff", "check", "."], id="lint"),
        pytest.param(["mypy"], id="types", marks=[pytest.mark.timeout(600), pytest.mark.slow]),
        pytest.param(["lint-imports"], id="layers"),
    ],
)
def test_the_house_is_in_order(command: list[str]) -> None:
    done = subprocess.run([SCRIPTS / command[0], *command[1:]], cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.timeout(2 * javascript.LIMIT_S)
def test_the_dashboards_javascript_is_in_order() -> None:
    try:
        done = javascript.check()
    except javascript.NotCheckedError as error:
        pytest.skip(str(error))
    assert done.returncode == 0, done.stdout + done.stderr


# What a plugin may import besides the plugin API: a simulation the model of its world, a replay the records of runs, a
# bridge the API of fleets, their latecomers and the sampler of records.
BESIDES = {
    "sim": {"eal_actors.device.proximity", "eal_actors.device.world"},
    "replay": {"eal_actors.recording.recorded_run"},
    "ros2": {"eal_actors", "eal_actors.facade.latecomers", "eal_actors.recording.sampler"},
    "vda5050": {"eal_actors", "eal_actors.facade.latecomers", "eal_actors.recording.sampler"},
}


def test_plugins_import_nothing_of_the_framework_but_the_plugin_api() -> None:
    pattern = re.compile(r"^\s*(?:from|import)\s+(eal_actors[.\w]*)", re.MULTILINE)
    for file in (ROOT / "plugins").rglob("*.py"):
        if not file.name.startswith("test_"):
            allowed = {"eal_actors.plugin"} | BESIDES.get(file.relative_to(ROOT / "plugins").parts[0], set())
            assert set(pattern.findall(file.read_text())) <= allowed, file


def test_the_core_imports_without_its_extras() -> None:
    program = (
        "import sys\n"
        "for name in ('numpy', 'cv2', 'pymunk', 'matplotlib'): sys.modules[name] = None\n"
        "import eal_actors\n"
        "with eal_actors.connect() as eal:\n"
        "    print(eal.get_value(eal.find_resource('SampleResource')).value)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("0\n", "")
