"""Device tree overlays: applied to the trees of a board, and refused with their names where they do not fit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.fields import OVERLAYS
from evbotos.hosttools import find_tool, needed_for
from evbotos.overlays import overlay_sha256, write_trees
from evbotos.plan import make_plan, step_names

SPI = "raspberry-pi-spi.dts"
BOARD = """/dts-v1/;
/ { soc { #address-cells = <1>; #size-cells = <1>;
    gpio@7e200000 { phandle = <1>; };
    spi@7e204000 { status = "disabled"; };
}; };
"""
BUSES = "/axi/pcie@1000120000/pci@0,0/dev@0,0/pci-ep-bus@1"
BOARD_5 = """/dts-v1/;
/ { aliases {}; axi { pcie@1000120000 { pci@0,0 { dev@0,0 { pci_ep_bus: pci-ep-bus@1 {
    rp1_clocks: clocks@40018000 {};
    rp1_gpio: pinctrl@400d0000 {};
    rp1_i2c1: i2c@40074000 { status = "disabled"; };
    rp1_i2c4: i2c@40080000 { status = "disabled"; };
    rp1_i2c6: i2c@40088000 { status = "disabled"; };
    rp1_csi0: csi@40110000 { status = "disabled"; };
    rp1_csi1: csi@40128000 { status = "disabled"; };
}; }; }; }; }; };
"""
"""A Raspberry Pi 5, as far as its overlays name it; `test_bindings.py` applies them to the kernel's tree."""
CONNECTORS = {0: ("i2c@40088000", "csi@40110000", "34"), 1: ("i2c@40080000", "csi@40128000", "46")}
"""Bus, receiver and the pin of the power of each connector of a Raspberry Pi 5."""
SENSORS = {
    "imx219": ("10", "24000000", "1 2", ("VANA", "VDIG", "VDDL")),
    "imx296": ("1a", "37125000", "1", ("avdd", "dvdd", "ovdd")),
    "ov5647": ("36", "25000000", "1 2", ("avdd", "dovdd", "dvdd")),
}
"""Address, clock, lanes and supplies."""

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
    subprocess.run(["dtc", "-q", "-@", "-O", "dtb", "-o", out], input=source.encode(), check=True)


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
@pytest.mark.parametrize("overlay", sorted(OVERLAYS.glob("raspberry-pi-*.dts")), ids=lambda overlay: overlay.stem)
def test_an_overlay_compiles_without_a_warning(overlay: Path) -> None:
    argv = [
        "dtc",
        "-@",
        "-Wno-interrupts_property",
        "-O",
        "dtb",
        "-o",
        "/dev/null",
        str(overlay),
    ]  # the board has parents
    done = subprocess.run(argv, capture_output=True, text=True, check=True)
    assert not done.stderr


@needs_dtc
@pytest.mark.parametrize("connector", CONNECTORS)
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_camera_of_a_raspberry_pi_5_has_bus_receiver_clock_and_power(
    sensor: str, connector: int, kernel: Path, tmp_path: Path
) -> None:
    compile_tree(BOARD_5, kernel / "board.dtb")
    write_trees(kernel, ["board.dtb"], [f"raspberry-pi-5-{sensor}-cam{connector}.dts"], tmp_path / "out")
    tree, (bus, receiver, pin) = tmp_path / "out/board.dtb", CONNECTORS[connector]
    address, clock_hz, lanes, supplies = SENSORS[sensor]
    device, sink = f"{BUSES}/{bus}/sensor@{address}", f"{BUSES}/{receiver}/port/endpoint"
    assert {read(tree, f"{BUSES}/{node}", "status") for node in (bus, receiver)} == {"okay"}
    assert read(tree, device, "compatible").endswith(f",{sensor}")
    assert read(tree, device, "reg", "x") == address
    assert read(tree, f"{device}/port/endpoint", "remote-endpoint", "u") == read(tree, sink, "phandle", "u")
    assert read(tree, sink, "remote-endpoint", "u") == read(tree, f"{device}/port/endpoint", "phandle", "u")
    assert read(tree, sink, "data-lanes", "u") == lanes
    clock, power = f"/clock-camera-{connector}", f"/regulator-camera-{connector}"
    assert read(tree, clock, "clock-frequency", "u") == clock_hz
    assert read(tree, device, "clocks", "u") == read(tree, clock, "phandle", "u")
    assert {read(tree, device, f"{name}-supply", "u") for name in supplies} == {read(tree, power, "phandle", "u")}
    pins = read(tree, f"{BUSES}/pinctrl@400d0000", "phandle", "u")
    assert read(tree, power, "gpio", "u") == f"{pins} {pin} 0"


@needs_dtc
def test_two_cameras_and_the_buses_of_the_pin_header_go_together(kernel: Path, tmp_path: Path) -> None:
    compile_tree(BOARD_5, kernel / "board.dtb")
    names = ("imx219-cam0", "imx219-cam1", "i2c", "spi", "pwm")
    write_trees(kernel, ["board.dtb"], [f"raspberry-pi-5-{name}.dts" for name in names], tmp_path / "out")
    tree = tmp_path / "out/board.dtb"
    for connector, (bus, _, _) in CONNECTORS.items():
        clock = read(tree, f"/clock-camera-{connector}", "phandle", "u")
        assert read(tree, f"{BUSES}/{bus}/sensor@10", "clocks", "u") == clock
    assert read(tree, "/aliases", "i2c1") == f"{BUSES}/i2c@40074000"
    pins = read(tree, f"{BUSES}/pinctrl@400d0000", "phandle", "u")
    assert read(tree, f"{BUSES}/spi@40050000", "cs-gpios", "u") == f"{pins} 8 1 {pins} 7 1"
    assert [read(tree, f"/pwm-{pin}", "gpios", "u") for pin in (18, 19)] == [f"{pins} 18 0", f"{pins} 19 0"]


@needs_dtc
def test_a_change_of_an_included_file_changes_the_hash_of_an_overlay(tmp_path: Path) -> None:
    part, own = tmp_path / "part.dtsi", tmp_path / "own.dts"
    own.write_text('/dts-v1/; /plugin/; /include/ "part.dtsi"')
    hashes = set()
    for number in range(2):
        part.write_text(f'/ {{ fragment@0 {{ target-path = "/"; __overlay__ {{ a = <{number}>; }}; }}; }};')
        hashes.add(overlay_sha256(str(own)))
    assert len(hashes) == 2


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
