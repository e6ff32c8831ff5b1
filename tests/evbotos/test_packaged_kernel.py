from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.hosttools import needed_for
from evbotos.lock import lock_path
from evbotos.model import PackagedKernel
from evbotos.packaged_kernel import in_order, unpack_kernel
from evbotos.plan import make_plan

LOCAL = """version: 1
platforms:
  qemu-amd64: {kernel: {package: linux-image-cloud-amd64, modules: [virtio_blk, squashfs]}}
"""


def module(folder: Path, name: str, *needs: str) -> Path:
    path = folder / f"{name}.ko"
    path.write_bytes(b"\x7fELF\0license=GPL\0depends=" + ",".join(needs).encode() + b"\0name=" + name.encode() + b"\0")
    return path


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    return {
        "virtio_blk": module(tmp_path, "virtio_blk", "virtio", "virtio_ring"),
        "virtio_ring": module(tmp_path, "virtio_ring", "virtio"),
        "virtio": module(tmp_path, "virtio"),
        "squashfs": module(tmp_path, "squashfs", "zstd-decompress"),
    }


def test_each_module_comes_after_what_it_needs_and_once(files: dict[str, Path]) -> None:
    order = in_order(("virtio-blk", "virtio_ring", "squashfs"), files, {"zstd_decompress"})
    assert [path.stem for path in order] == ["virtio", "virtio_ring", "virtio_blk", "squashfs"]


def test_a_module_that_is_not_there_is_named(files: dict[str, Path]) -> None:
    with pytest.raises(BuildError, match="no module zstd_decompress"):
        in_order(("squashfs",), files, set())


def test_a_module_may_have_parameters(tmp_path: Path, files: dict[str, Path]) -> None:
    package = tmp_path / "package"
    for name, path in files.items():
        place = package / "lib/modules/6.1/kernel" / f"{name}.ko"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(path.read_bytes().replace(b"zstd-decompress", b""))
    (package / "boot").mkdir()
    (package / "boot/vmlinuz-6.1").write_bytes(b"kernel")
    (package / "DEBIAN").mkdir()
    (package / "DEBIAN/control").write_text(
        "Package: linux\nVersion: 1\nArchitecture: amd64\nMaintainer: a <a@b.c>\nDescription: d\n"
    )
    subprocess.run(["dpkg-deb", "-b", package, tmp_path / "linux.deb"], check=True, stdout=subprocess.DEVNULL)
    wanted = PackagedKernel(package="linux", modules=("squashfs", "virtio-blk num_request_queues=2"))
    (tmp_path / "work").mkdir()
    unpack_kernel(tmp_path / "linux.deb", wanted, tmp_path / "work/out")
    found = {path.name: path for path in (tmp_path / "work/out/modules").iterdir()}
    assert sorted(found) == [
        "000-squashfs.ko",
        "001-virtio.ko",
        "002-virtio_ring.ko",
        "003-virtio_blk.ko",
        "003-virtio_blk.parameters",
    ]
    assert found["003-virtio_blk.parameters"].read_text() == "num_request_queues=2\n"


def test_a_user_may_take_debians_kernel_and_then_nothing_is_compiled(tmp_path: Path) -> None:
    local = tmp_path / "local.yaml"
    local.write_text(LOCAL)
    found = load_definitions(local)
    platform, image = found.platform("qemu-amd64"), found.image("robot")
    assert platform.loader == "none"
    assert {"gcc", "flex", "grub-mkimage"} & set(needed_for(load_definitions().platform("qemu-amd64")))
    assert not {"gcc", "flex", "grub-mkimage"} & set(needed_for(platform))
    assert lock_path(platform, image).name == "qemu-amd64-robot-packaged.lock.yaml"
    assert any("unpack linux-image-cloud-amd64" in step for step in make_plan(platform, image, None)["steps"])


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("qemu-amd64: {kernel: {package: linux-image-cloud-amd64}}", "modules: is missing"),
        ("qemu-amd64: {kernel: {package: linux, modules: [x], image: y}}", "image"),
        ("qemu-amd65: {kernel: {package: linux, modules: [x]}}", "there is no platform 'qemu-amd65'; did you mean"),
    ],
)
def test_a_wrong_kernel_is_told(tmp_path: Path, wrong: str, told: str) -> None:
    local = tmp_path / "local.yaml"
    local.write_text(f"version: 1\nplatforms: {{{wrong}}}\n")
    with pytest.raises(ConfigError, match=told):
        load_definitions(local)
