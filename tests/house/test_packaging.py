"""The wheel and the sdist carry what a first run needs, and work away from the checkout and without the extras."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.net.links import free_port

ROOT = Path(__file__).parents[2]
HEAVY = ("numpy", "cv2", "pymunk", "matplotlib")
USER_SCRIPT = """
from eal_actors import EAL, Fleet, Future, connect
from eal_actors.device.data import EALData


def turn(name: str) -> Future[int]:
    with Fleet.load("sim") as fleet:
        return fleet[name]["Base"].send_cmd("r90")


def read(eal: EAL) -> EALData:
    return eal.get_value(eal.find_resource("Pose"))


reveal_type(connect("roomba-1", fleet="sim"))
wrong: str = connect(5)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the sdist."""
    folder = tmp_path_factory.mktemp("built")
    build(ROOT, folder)
    return folder


def build(source: Path, folder: Path, *targets: str) -> None:
    options = [option for target in targets for option in ("-t", target)]
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), *options]
    subprocess.run(command, cwd=source, check=True, capture_output=True, timeout=120)


def test_a_package_index_can_render_the_long_description(built: Path) -> None:
    command = [sys.executable, "-m", "twine", "check", "--strict", *map(str, built.iterdir())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def wheel_in(folder: Path) -> Path:
    (wheel,) = folder.glob("*.whl")
    return wheel


class Installed:
    """An environment with the project installed in it, and an empty folder to work in."""

    def __init__(self, folder: Path) -> None:
        self.bin = folder / "venv" / "bin"
        self.home = folder / "home"
        self.home.mkdir(parents=True)

    def pip(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "pip", "--python", str(self.bin / "python"), "install", "--quiet"]
        done = subprocess.run(
            [*command, "--disable-pip-version-check", "--no-warn-script-location", *arguments],
            capture_output=True,
            text=True,
            timeout=900,
        )
        assert done.returncode == 0, done.stdout + done.stderr

    def borrow_dependencies(self) -> None:
        """Find the dependencies in the environment of the tests."""
        (site,) = (self.bin.parent / "lib").glob("python*/site-packages")
        (site / "dependencies.pth").write_text(f"{sysconfig.get_path('purelib')}\n{sysconfig.get_path('platlib')}\n")

    def environment(self) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
        return {**kept, "PATH": f"{self.bin}:{os.environ['PATH']}", "HOME": str(self.home), "NO_COLOR": "1"}

    def run(self, program: str, *arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [self.bin / program, *arguments],
            cwd=self.home,
            env=self.environment(),
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == code, done.stdout + done.stderr
        return done

    @contextmanager
    def serving(self, fleet: str, robot: str) -> Iterator[None]:
        command = [str(self.bin / "eal"), "serve", "--fleet", fleet, "--robot", robot]
        with subprocess.Popen(
            command, cwd=self.home, env=self.environment(), stdout=subprocess.PIPE, text=True
        ) as server:
            try:
                assert any(line.startswith("listening") for line in server.stdout or ())
                yield
            finally:
                server.terminate()
                server.communicate(timeout=60)


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel installed in an environment of its own, which finds the dependencies in that of the tests."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "venv", with_pip=False, symlinks=True)
    environment = Installed(folder)
    environment.pip("--no-deps", "--no-index", str(wheel_in(built)))
    environment.borrow_dependencies()
    where = environment.run("python", "-c", "import eal_actors; print(eal_actors.__file__)").stdout
    assert where.startswith(str(folder)), where
    return environment


def test_the_wheel_holds_types_plugins_fleets_scenarios_and_worlds_and_no_tests(built: Path) -> None:
    with zipfile.ZipFile(wheel_in(built)) as archive:
        names = set(archive.namelist())
    for folder in ("plugins", "fleets", "scenarios"):
        for file in (ROOT / folder).rglob("*"):
            if file.suffix in (".py", ".yaml", ".md") and "__pycache__" not in file.parts:
                assert f"eal_actors/_bundled/{file.relative_to(ROOT)}" in names
    for package in ("eal_actors", "evbotos"):
        for file in (ROOT / package).rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                assert str(file.relative_to(ROOT)) in names
    assert "eal_actors/py.typed" in names
    assert not [name for name in names if "__pycache__" in name or name.startswith(("tests/", "docs/", "runs/"))]


def test_the_sdist_makes_both_again_to_the_bit(built: Path, tmp_path: Path) -> None:
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    for file in (
        "README.md",
        "LICENSE",
        "CHANGELOG.md",
        "Makefile",
        "docs/plugins.md",
        "tests/house/test_packaging.py",
    ):
        assert (source / file).is_file(), file
    assert not [file for file in ("runs", ".venv", ".mypy_cache") if (source / file).exists()]

    (source / "PKG-INFO").unlink()  # hatchling writes it; what is left is a checkout
    for number, path in enumerate(sorted(source.rglob("*"))):  # another checkout: other times, another umask
        os.utime(path, (number, number))
        path.chmod(path.stat().st_mode & 0o700)
    build(source, tmp_path / "again")

    assert digests(tmp_path / "again") == digests(built)


def digests(folder: Path) -> dict[str, str]:
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in folder.iterdir()}


def test_the_advice_to_install_an_extra_needs_no_index_for_the_framework_itself(installed: Installed) -> None:
    installed.pip("--no-index", "eal-actors[sim,vision,record,dashboard,evbotos]")


def test_the_facade_works_from_it_without_the_extras(installed: Installed) -> None:
    program = (
        "import sys\n"
        f"for name in {HEAVY}: sys.modules[name] = None\n"
        "import eal_actors\n"
        "with eal_actors.connect() as eal:\n"
        "    print(eal.get_value(eal.find_resource('SampleResource')).value)\n"
    )
    assert installed.run("python", "-c", program).stdout == "0\n"
    assert "sample" in installed.run("eal", "plugin", "list").stdout


def test_the_demo_runs_from_any_folder_by_name(installed: Installed) -> None:
    said = installed.run("eal", "run", "dance", "--fleet", "sim", "--rate", "max", "--json", "--no-plot")

    assert json.loads(said.stdout)["outcome"] == "done"
    assert [path.name for path in installed.home.glob("runs/*/summary.json")] == ["summary.json"]


def test_an_unknown_name_is_told_what_there_is(installed: Installed) -> None:
    said = installed.run("eal", "run", "dance", "--fleet", "sims", code=2).stderr

    assert "no fleet of that name comes with the framework; did you mean 'sim'?" in said


def test_a_calibration_is_not_written_beside_what_was_installed(installed: Installed) -> None:
    command = (
        "eal",
        "calibrate",
        "--robot",
        "roomba-1",
        "--side",
        "0.3",
        "--runs",
        "1",
        "--fast",
        "--write",
        "--fleet",
    )
    said = " ".join(installed.run(*command, "sim", code=2).stderr.split())
    assert "your own fleet file with `include: [sim]` below `version: 1`" in said

    (installed.home / "mine.yaml").write_text("version: 1\ninclude: [sim]\n")
    installed.run(*command, "mine.yaml")
    assert (installed.home / "mine.yaml").read_text() == "version: 1\ninclude: [sim, mine-roomba-1.calibration.yaml]\n"


# The same in empty environments, with the dependencies that pip finds.


@pytest.fixture(params=["wheel", "sdist"])
def package(request: pytest.FixtureRequest, built: Path) -> Path:
    (sdist,) = built.glob("*.tar.gz")
    return wheel_in(built) if request.param == "wheel" else sdist


@pytest.fixture
def empty(tmp_path: Path) -> Installed:
    """An empty environment."""
    venv.create(tmp_path / "venv", with_pip=False, symlinks=True)
    return Installed(tmp_path)


def test_a_new_plugin_can_be_built_installed_and_used_by_its_name(built: Path, empty: Installed) -> None:
    empty.pip("--no-deps", "--no-index", str(wheel_in(built)))
    empty.borrow_dependencies()
    empty.run("eal", "plugin", "new", "my_lift", "--dir", "own")
    project = empty.home / "own" / "my_lift"
    build = [sys.executable, "-m", "hatchling", "build", "--directory", str(empty.home / "dist")]
    done = subprocess.run(build, cwd=project, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    (sdist,) = (empty.home / "dist").glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(empty.home / "unpacked", filter="data")
    with zipfile.ZipFile(wheel_in(empty.home / "dist")) as archive:
        names = sorted(name for name in archive.namelist() if ".dist-info" not in name)
    assert names == [f"eal_plugin_my_lift/{name}" for name in ("README.md", "__init__.py", "plugin.py", "plugin.yaml")]
    project.rename(empty.home / "elsewhere")

    empty.pip("--no-deps", "--no-index", str(wheel_in(empty.home / "dist")))

    assert "my_lift" in empty.run("eal", "plugin", "list").stdout
    (empty.home / "f.yaml").write_text("version: 1\nname: f\nrobots: {one: {plugins: {my_lift: {}}}}\n")
    assert empty.run("eal", "call", "one", "MyLift", "send_cmd", "to0.01", "--fleet", "f.yaml").stdout == "1\n"
    (source,) = (empty.home / "unpacked").iterdir()
    subprocess.run([*build, "--target", "wheel"], cwd=source, check=True, capture_output=True, timeout=120)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_demo_runs_in_an_empty_environment(package: Path, empty: Installed) -> None:
    empty.pip(f"{package}[sim,record]")

    empty.run("eal", "run", "dance", "--fleet", "sim", "--rate", "max", "--record", "all")

    (run,) = (empty.home / "runs").iterdir()
    assert {"summary.json", "events.jsonl", "trajectory.csv", "trajectory.png", "run.mcap"} <= {
        file.name for file in run.iterdir()
    }
    empty.run("eal", "report", str(run))
    empty.run("eal", "world", "lab")
    empty.run("eal", "rehearse", "dance", "--fleet", "sim", "--seeds", "1")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_robot_side_serves_without_numpy_opencv_and_pymunk(package: Path, empty: Installed) -> None:
    empty.pip(str(package))
    found = f"import importlib.util as u; print([name for name in {HEAVY} if u.find_spec(name)])"
    assert empty.run("python", "-c", found).stdout == "[]\n"
    address = f"tcp/127.0.0.1:{free_port()}"
    (empty.home / "one.yaml").write_text(
        f"version: 1\nname: one\nrobots: {{r: {{address: {address}, plugins: {{sample: {{}}, system: {{}}}}}}}}\n"
    )

    with empty.serving("one", "r"):
        assert empty.run("eal", "call", "r", "SampleResource", "set_value", "5", "--fleet", "one").stdout == "1\n"
        assert empty.run("eal", "call", "r", "SampleResource", "get_value", "--fleet", "one").stdout == "5\n"
    assert "pip install 'eal-actors[sim]'" in empty.run("eal", "run", "dance", "--fleet", "sim", code=3).stderr


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_users_programs_are_checked_against_the_types(built: Path, empty: Installed) -> None:
    empty.pip(str(wheel_in(built)), "mypy")
    (empty.home / "mine.py").write_text(USER_SCRIPT)

    said = empty.run("mypy", "--strict", "mine.py", code=1).stdout

    assert 'mine.py:15: note: Revealed type is "eal_actors.facade.eal.EAL"' in said
    errors = [line for line in said.splitlines() if ": error:" in line]
    assert [line.split(": ")[0] for line in errors] == ["mine.py:16", "mine.py:16"], said
