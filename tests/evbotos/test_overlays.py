"""Device tree overlays: applied to the trees of a board, and refused with their names where they do not fit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool, needed_for
from evbotos.overlays import write_trees
from evbotos.plan import make_plan, step_names

SPI = "raspberry-pi-spi.dts"
BOARD = """/dts-v1/;
/ { soc { #address-cells = <1>; #size-cells = <1>;
    gpio@7e200000 { phandle = <1>; };
    spi@7e204000 { status = "disabled"; };
}; };
"""

needs_dtc = pytest.mark.skipif(
    None in (find_tool("dtc"), find_tool("fdtoverlay")), reason="not installed: dtc (make evbotos-setup)"
)


@pytest.fixture
def kernel(tmp_path: Path) -> Path:
    """The folder of a kernel with the device tree of a board."""
    folder = tmp_path / "kernel"
    folder.mkdir()
    (folder / "Image.gz").write_bytes(b"kernel")
    compile_tree(BOARD, folder / "board.dtb")
    return folder


def compile_tree(source: str, out: Path) -> None:
    subprocess.run(["dtc", "-q", "-O", "dtb", "-o", out], input=source.encode(), check=True)


def read(tree: Path, node: str, name: str, kind: str = "s") -> str:
    told = subprocess.run(["fdtget", "-t", kind, tree, node, name], capture_output=True, text=True, check=True)
    return told.stdout.strip()


@needs_dtc
def test_spi_has_its_pins_and_two_devices(kernel: Path, tmp_path: Path) -> None:
    write_trees(kernel, ["board.dtb"], [SPI], tmp_path / "out")
    tree = tmp_path / "out/board.dtb"
    bus = "/soc/spi@7e204000"
    assert read(tree, bus, "status") == "okay"
    assert [read(tree, f"{bus}/device@{number}", "reg", "u") for number in range(2)] == ["0", "1"]
    assert read(tree, bus, "pinctrl-0", "u") == read(tree, "/soc/gpio@7e200000/spi_pins", "phandle", "u")
    assert (tmp_path / "out/Image.gz").read_bytes() == b"kernel"
    assert read(kernel / "board.dtb", bus, "status") == "disabled"


@needs_dtc
def test_overlays_that_are_malformed_or_do_not_fit_are_named(kernel: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.dts"
    own.write_text('/dts-v1/; /plugin/; / { fragment@0 { target-path = "/no"; __overlay__ { a; }; }; };')
    with pytest.raises(BuildError, match=r"the overlay \S*own\.dts does not fit board\.dtb"):
        write_trees(kernel, ["board.dtb"], [str(own)], tmp_path / "out")
    own.write_text("/dts-v1/; /plugin/; / {")
    with pytest.raises(BuildError, match="syntax error"):
        write_trees(kernel, ["board.dtb"], [str(own)], tmp_path / "out2")


def test_a_board_without_device_trees_takes_no_overlays(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match=f"no device trees to which {SPI} could apply"):
        write_trees(tmp_path, [], [SPI], tmp_path / "out")


def test_local_yaml_selects_overlays(tmp_path: Path) -> None:
    local = tmp_path / "local.yaml"
    local.write_text(f"version: 1\nplatforms: {{raspberry-pi: {{overlays: [{SPI}]}}}}\n")
    found = load_definitions(local)
    platform, image = found.chosen("raspberry-pi", "robot")
    assert platform.overlays == (SPI,)
    assert platform.kernel == load_definitions().platform("raspberry-pi").kernel
    assert found.lock_path(platform, image) == load_definitions().lock_path(platform, image)
    assert "overlays" in step_names(platform, image)
    assert f"overlays: apply {SPI} to the device trees" in make_plan(platform, image, None)["steps"]
    assert {"dtc", "fdtoverlay"} <= set(needed_for(platform))
    local.write_text("version: 1\nplatforms: {raspberry-pi: {overlays: [raspberry-spi.dts]}}\n")
    with pytest.raises(ConfigError, match=r"local\.yaml:2:.*no file raspberry-spi\.dts.*'raspberry-pi-spi\.dts'"):
        load_definitions(local)
