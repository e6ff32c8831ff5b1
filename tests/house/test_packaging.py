"""The wheel carries what a first run needs, and works away from the checkout and without the extras."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the built wheel unpacked in it."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=120)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def run(site: Path, *command: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(site), "NO_COLOR": "1"}
    done = subprocess.run(
        [sys.executable, *command], cwd=site.parent, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_it_holds_types_plugins_fleets_and_scenarios(site: Path) -> None:
    for file in (
        "eal_actors/py.typed",
        "eal_actors/_bundled/plugins/sample/plugin.yaml",
        "eal_actors/_bundled/plugins/sim/plugin.py",
        "eal_actors/_bundled/fleets/local.yaml",
        "eal_actors/_bundled/scenarios/dance.yaml",
    ):
        assert (site / file).is_file(), file
    assert not list(site.rglob("__pycache__"))
    assert not (site / "tests").exists()


def test_the_facade_and_the_command_line_work_from_it(site: Path) -> None:
    program = (
        "import sys\n"
        "for name in ('numpy', 'cv2', 'pymunk', 'matplotlib'): sys.modules[name] = None\n"
        "import eal_actors\n"
        "assert 'site/eal_actors' in eal_actors.__file__, eal_actors.__file__\n"
        "with eal_actors.connect() as eal:\n"
        "    print(eal.get_value(eal.find_resource('SampleResource')).value)\n"
    )
    assert run(site, "-c", program) == "0\n"
    assert "sample" in run(site, "-m", "eal_actors", "plugin", "list")
