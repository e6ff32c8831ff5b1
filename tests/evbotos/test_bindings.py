"""The overlays of a Raspberry Pi 5, applied to the device trees of its kernel, follow the kernel's own bindings."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.fields import OVERLAYS
from evbotos.hosttools import find_tool
from evbotos.lock import read_lock
from evbotos.overlays import write_trees

PLATFORM = "raspberry-pi-5"
PARTS = (
    "Documentation/devicetree",
    "include/dt-bindings",
    "arch/arm64/boot/dts/broadcom",
    "scripts/dtc/include-prefixes",
    "include/uapi/linux/input-event-codes.h",
)
TREES = ("bcm2712-rpi-5-b.dtb", "bcm2712-d-rpi-5-b.dtb")
PROGRAMS = {name: Path(sys.executable).with_name(name) for name in ("dt-mk-schema", "dt-validate")}
KNOWN = "sensor@1a (sony,imx296): 'rotation' does not match any of the regexes"
"""The driver reads this property, as those of the other sensors do; the binding does not name it."""
NAMES = sorted(path.name for path in OVERLAYS.glob("raspberry-pi-5-*.dts"))
TOGETHER = [name for name in NAMES if "imx219" in name or not re.search("cam|mcp2515", name)]

pytestmark = [
    pytest.mark.evbotos,
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(not all(map(Path.is_file, PROGRAMS.values())), reason="dtschema is in the group `bindings`"),
    pytest.mark.skipif(None in map(find_tool, ("cpp", "dtc", "fdtoverlay")), reason="not installed: cpp, dtc"),
]


def run(*argv: str | Path, cwd: Path | None = None) -> str:
    done = subprocess.run(list(map(str, argv)), cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def kernel_source(out: Path) -> Path:
    """Unpack what the locked kernel says of device trees; return its folder."""
    found = load_definitions()
    platform, image = found.chosen(PLATFORM, "robot")
    lock_file = found.lock_path(platform, image)
    lock = read_lock(lock_file)
    assert lock is not None
    (package,) = Build(platform, image, found.local, lock_file, print)._debs([lock.kernel])
    run("dpkg-deb", "-x", package, out)
    source = out / lock.kernel.name
    run("tar", "-xf", f"usr/src/{source.name}.tar.xz", *(f"{source.name}/{part}" for part in PARTS), cwd=out)
    return source


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the device trees of the locked kernel, and their schema."""
    out = tmp_path_factory.mktemp("kernel")
    source = kernel_source(out)
    folder = source / PARTS[2]
    cpp = ("cpp", "-nostdinc", "-undef", "-D__DTS__", "-xassembler-with-cpp", "-I", source / PARTS[3])
    for tree in TREES:
        (folder / "all.dts").write_text(run(*cpp, (folder / tree).with_suffix(".dts")))
        run("dtc", "-q", "-@", "-i", folder, "-O", "dtb", "-o", out / tree, folder / "all.dts")
    run(PROGRAMS["dt-mk-schema"], "-j", "-o", out / "schema.json", source / PARTS[0] / "bindings")
    return out


def problems(kernel: Path, tree: Path) -> set[str]:
    """Return what violates the bindings, without the name of the tree."""
    said = run(PROGRAMS["dt-validate"], "-s", kernel / "schema.json", tree)
    return {line.removeprefix(f"{tree}: ") for line in said.splitlines() if line.startswith(f"{tree}: ")}


@pytest.mark.parametrize("names", [*([name] for name in NAMES), TOGETHER], ids="+".join)
def test_a_tree_with_overlays_follows_the_bindings(names: list[str], kernel: Path, tmp_path: Path) -> None:
    for tree in TREES:
        (tmp_path / "trees").mkdir(exist_ok=True)
        (tmp_path / "trees" / tree).write_bytes((kernel / tree).read_bytes())
    write_trees(tmp_path / "trees", TREES, names, tmp_path / "out")
    for tree in TREES:
        new = problems(kernel, tmp_path / "out" / tree) - problems(kernel, kernel / tree)
        assert not {one for one in new if not one.startswith(KNOWN)}


def test_a_wrong_overlay_is_found(kernel: Path, tmp_path: Path) -> None:
    for name in ("raspberry-pi-5-cam0.dtsi", "raspberry-pi-5-imx219-cam0.dts", "imx219.dtsi"):
        (tmp_path / name).write_text((OVERLAYS / name).read_text().replace("VDDL-supply", "VDD-supply"))
    (tmp_path / "trees").mkdir()
    (tmp_path / "trees" / TREES[0]).write_bytes((kernel / TREES[0]).read_bytes())
    write_trees(tmp_path / "trees", TREES[:1], [str(tmp_path / "raspberry-pi-5-imx219-cam0.dts")], tmp_path / "out")
    assert any("'VDDL-supply' is a required property" in one for one in problems(kernel, tmp_path / "out" / TREES[0]))
