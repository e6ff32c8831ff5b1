"""The drivers of a Raspberry Pi 5 accept what the overlays say, up to the first register of a sensor that is not there.

QEMU's machine `virt` gets the nodes of the RP1 chip of the kernel's own source, with memory in place of registers.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from evbotos.build import Build, cache_folder
from evbotos.definitions import load_definitions
from evbotos.fields import OVERLAYS
from evbotos.lock import read_lock
from evbotos.overlays import write_trees
from evbotos.steps import owned
from tests.evbotos.proof import require_tools
from tests.evbotos.test_bindings import PARTS, PLATFORM, kernel_source, run

MEMORY = 0x50000000
"""The address of the memory in place of the registers."""
INTERRUPTS = (0, 1, 2, 6, 8, 11, 13, 19, 25, 31, 36, 47, 48)
RP1 = f"""
/ {{
    aliases {{}};
    reserved-memory {{
        #address-cells = <2>; #size-cells = <2>; ranges;
        rp1@{MEMORY:x} {{ reg = <0 {MEMORY:#x} 0 0x400000>; no-map; }};
        linux,cma {{ compatible = "shared-dma-pool"; size = <0 0x4000000>; reusable; linux,cma-default; }};
    }};
    clk_rp1_xosc: clock-50000000 {{ compatible = "fixed-clock"; #clock-cells = <0>; clock-frequency = <50000000>; }};
    axi {{ compatible = "simple-bus"; #address-cells = <2>; #size-cells = <2>; ranges;
    pcie@1000120000 {{ compatible = "simple-bus"; #address-cells = <2>; #size-cells = <2>; ranges;
    pci@0,0 {{ compatible = "simple-bus"; #address-cells = <2>; #size-cells = <2>; ranges;
    dev@0,0 {{ compatible = "simple-bus"; #address-cells = <2>; #size-cells = <2>;
        ranges = <0 0 0 {MEMORY:#x} 0 0x400000>;
        #interrupt-cells = <2>;
        interrupt-map-mask = <0 0 0x3f 0>;
        interrupt-map = {", ".join(f"<0 0 {one} 4 &{{/intc@8000000}} 0 0 0 {100 + one} 4>" for one in INTERRUPTS)};
#include "rp1-common.dtsi"
    }}; }}; }}; }};
}};
&pci_ep_bus {{ ranges = <0 0x40000000 0 0 0 0x400000>; }};
&rp1_clocks {{
    compatible = "fixed-clock";
    clock-frequency = <200000000>;
    /delete-property/ assigned-clocks; /delete-property/ assigned-clock-rates; /delete-property/ clocks;
}};
"""
SERIAL = """
&pci_ep_bus { serial@40030000 {
    compatible = "arm,pl011", "arm,primecell"; reg = <0 0x40030000 0 0x100>; arm,primecell-periphid = <0x541011>;
    interrupts = <25 4>; clocks = <&rp1_clocks 15>, <&rp1_clocks 6>; clock-names = "uartclk", "apb_pclk";
}; };
"""
I2C_TYPE = 0x44570140
"""The identification of an I2C controller, in its register 0xfc."""
RECEIVERS = (r"rp1-cfe 50110000\.csi: PiSP FE", r"rp1-cfe 50128000\.csi: PiSP FE")
ABSENT = {
    "imx219": r"imx219 \d-0010: error -110: failed to read chip id 219",
    "imx296": r"imx296 \d-001a: failed to get sensor out of standby \(-110\)",
    "ov5647": r"ov5647 \d-0036: write sensor_oe_enable_regs error",
}
"""The driver has its clock, lanes and voltages, and nobody answers on the bus (-110)."""
ABSENT_CAN = r"mcp251x spi\d\.0: error -110: Cannot initialize MCP2515\. Wrong wiring\?"
"""The driver has its clock, pins and interrupt, and the bus, which is memory, moves nothing."""

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(7200)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the kernel of the image `libcamera`, the source of its device trees, and QEMU's own tree."""
    out = tmp_path_factory.mktemp("rp1")
    found = load_definitions()
    platform, lock_file = found.chosen(PLATFORM, "libcamera")[0], found.lock_path(*found.chosen(PLATFORM, "robot"))
    require_tools(platform)
    lock = read_lock(lock_file)
    assert lock is not None
    build = Build(platform, found.image("robot"), found.local, lock_file, print)
    with owned(cache_folder(found.local)):
        (out / "kernel").symlink_to(build.runner.run(build._kernel_step(lock)))
        kernel_source(out)
    run("qemu-system-aarch64", "-machine", f"virt,dumpdtb={out / 'virt.dtb'}", "-cpu", "cortex-a76", "-m", "512")
    run("dtc", "-q", "-O", "dts", "-o", out / "virt.dts", out / "virt.dtb")
    return out


def said(folder: Path, overlays: Sequence[str], out: Path, more: str = "") -> str:
    """Start the kernel with RP1 and overlays, and return what it says until it finds no root."""
    source = next(folder.glob("linux-source-*"))
    (out / "all.dts").write_text((folder / "virt.dts").read_text() + RP1 + more)
    includes = [part for name in PARTS[2:4] for part in ("-I", source / name)]
    cpp = run("cpp", "-nostdinc", "-undef", "-D__DTS__", "-xassembler-with-cpp", *includes, out / "all.dts")
    (out / "all.dts").write_text(cpp)
    (out / "trees").mkdir()
    run("dtc", "-q", "-@", "-O", "dtb", "-o", out / "trees/rp1.dtb", out / "all.dts")
    write_trees(out / "trees", ["rp1.dtb"], overlays, out / "out")
    argv = ["qemu-system-aarch64", "-accel", "tcg,tb-size=64", "-machine", "virt", "-cpu", "cortex-a76", "-m", "512"]
    argv += ["-nographic", "-no-reboot", "-kernel", str(folder / "kernel/Image.gz"), "-dtb", str(out / "out/rp1.dtb")]
    argv += ["-append", "console=ttyAMA0 loglevel=8 panic=-1"]
    for bus in range(7):
        argv += ["-device", f"loader,addr={MEMORY + 0x700FC + 0x4000 * bus:#x},data={I2C_TYPE:#x},data-len=4"]
    return subprocess.run(argv, capture_output=True, text=True, timeout=600, check=True).stdout


@pytest.mark.parametrize("sensors", [("imx219", "imx296"), ("ov5647", "imx219"), ("imx296", "ov5647")], ids="+".join)
def test_receivers_start_and_sensors_are_asked(sensors: tuple[str, str], folder: Path, tmp_path: Path) -> None:
    cameras = [f"raspberry-pi-5-{sensor}-cam{connector}.dts" for connector, sensor in enumerate(sensors)]
    buses = [f"raspberry-pi-5-{bus}.dts" for bus in ("i2c", "spi", "pwm")]
    words = said(folder, [*cameras, *buses], tmp_path)
    assert not [one for one in (*RECEIVERS, *(ABSENT[sensor] for sensor in sensors)) if not re.search(one, words)]
    failed = set(re.findall(r"probe with driver (\S+) failed", words))
    assert failed == set(sensors)


def test_a_driver_refuses_a_wrong_clock(folder: Path, tmp_path: Path) -> None:
    name = "raspberry-pi-5-imx219-cam0.dts"
    for part in (name, "raspberry-pi-5-cam0.dtsi", "imx219.dtsi"):
        (tmp_path / part).write_text((OVERLAYS / part).read_text().replace("<24000000>", "<25000000>"))
    assert "xclk frequency not supported: 25000000 Hz" in said(folder, [str(tmp_path / name)], tmp_path)


def test_the_driver_of_a_can_board_is_asked(folder: Path, tmp_path: Path) -> None:
    assert re.search(ABSENT_CAN, said(folder, ["raspberry-pi-5-mcp2515.dts"], tmp_path))


def test_linux_makes_no_serial_port_at_addresses_of_another_device(folder: Path, tmp_path: Path) -> None:
    words = said(folder, ["raspberry-pi-5-imx219-cam0.dts"], tmp_path, SERIAL)
    assert re.search(r"amba_device_add\(\) failed \(-16\) for \S+/serial@40030000", words)
    assert re.search(RECEIVERS[0], words)
