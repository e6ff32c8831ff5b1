"""`evbotos sdk`: a sysroot, and a script that compilers work with."""

from __future__ import annotations

import os
import shutil
import subprocess
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.lock import lock_path, read_lock
from evbotos.sdk import environment_text, make_links_relative, make_sysroot, python_of, write_archive
from evbotos.sdk_command import sdk
from evbotos.targets import TARGETS
from evbotos.tree import unpack_packages
from tests.evbotos.odometer import built_module

FILES = {
    "usr/include/stdio.h": "int puts(const char *);",
    "usr/include/python3.11/Python.h": "",
    "usr/lib/arm-linux-gnueabihf/libc.so": "GROUP ( /lib/arm-linux-gnueabihf/libc.so.6 )",
    "usr/lib/arm-linux-gnueabihf/libc.so.6": "",
    "usr/lib/arm-linux-gnueabihf/crt1.o": "",
    "usr/lib/gcc/arm-linux-gnueabihf/12/libgcc.a": "",
    "usr/bin/gcc": "",
    "usr/share/doc/libc6/copyright": "",
}

MakePackage = Callable[[str, dict[str, str]], Path]


@pytest.fixture
def make_package(tmp_path: Path) -> MakePackage:
    if find_tool("dpkg-deb") is None:
        pytest.skip("dpkg-deb is not installed")

    def make(name: str, files: dict[str, str]) -> Path:
        folder = tmp_path / name
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(content)
        (folder / "usr/lib").mkdir(parents=True, exist_ok=True)
        (folder / "usr/lib/libm.so").symlink_to("/lib/libm.so.6")
        (folder / "usr/lib/libm.so.6").touch()
        (folder / "usr/lib/libgone.so").symlink_to("/lib/libgone.so.1")
        (folder / "DEBIAN").mkdir()
        control = f"Package: {name}\nVersion: 1\nArchitecture: armhf\nMaintainer: nobody\nDescription: none\n"
        (folder / "DEBIAN/control").write_text(control)
        subprocess.run(["dpkg-deb", "-b", folder, tmp_path / f"{name}.deb"], check=True, stdout=subprocess.DEVNULL)
        return tmp_path / f"{name}.deb"

    return make


def test_a_sysroot_holds_what_compilers_read(tmp_path: Path, make_package: MakePackage) -> None:
    root = tmp_path / "sysroot"
    make_sysroot([make_package("all", FILES)], root)
    files = {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()}
    assert {"usr/include/stdio.h", "usr/lib/arm-linux-gnueabihf/crt1.o", "usr/lib/libm.so"} <= files
    assert not {path for path in files if path.startswith(("usr/bin", "usr/share", "usr/lib/gcc"))}
    assert not (root / "usr/lib/libm.so").readlink().is_absolute()
    assert (root / "usr/lib/libm.so").resolve() == root / "usr/lib/libm.so.6"
    assert not (root / "usr/lib/libgone.so").is_symlink()
    assert (root / "lib").readlink() == Path("usr/lib")  # by which the linker's scripts find what they name
    assert python_of(root) == "3.11"


def test_a_sysroot_without_headers_is_told(tmp_path: Path, make_package: MakePackage) -> None:
    files = {name: text for name, text in FILES.items() if "Python.h" not in name}
    with pytest.raises(BuildError, match=r"lack usr/include/python3\*/Python\.h"):
        make_sysroot([make_package("some", files)], tmp_path / "sysroot")


def test_links_stay_within_the_tree(tmp_path: Path) -> None:
    (tmp_path / "usr/lib/deep").mkdir(parents=True)
    (tmp_path / "usr/lib/libx.so.1").touch()
    (tmp_path / "usr/lib/deep/libx.so").symlink_to("/usr/lib/libx.so.1")
    (tmp_path / "usr/lib/passwd.so").symlink_to("/etc/passwd")
    make_links_relative(tmp_path)
    assert (tmp_path / "usr/lib/deep/libx.so").readlink() == Path("../libx.so.1")
    assert not (tmp_path / "usr/lib/passwd.so").is_symlink()


def test_every_platform_has_a_compiler_and_a_script_that_shells_take(tmp_path: Path) -> None:
    for platform in load_definitions().platforms.values():
        script = tmp_path / "environment"
        script.write_text(environment_text(platform, "3.11"))
        subprocess.run(["sh", "-n", script], check=True)
        cross = getattr(platform.kernel, "cross", None)
        if cross is not None:
            assert TARGETS[platform.architecture].compiler == cross


def test_the_script_says_what_is_missing(tmp_path: Path) -> None:
    platform = load_definitions().platforms["beagle-armhf"]
    (tmp_path / "environment").write_text(environment_text(platform, "3.11"))
    done = subprocess.run(["sh", "-c", ". ./environment"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, "set EVBOTOS_SDK" in done.stderr) == (1, True)
    (tmp_path / "sysroot/usr/include").mkdir(parents=True)
    (tmp_path / "sysroot/usr/include/stdio.h").touch()
    (tmp_path / "bin").mkdir()
    for name in ("sh", "dirname"):
        (tmp_path / "bin" / name).symlink_to(str(shutil.which(name)))
    env = {"PATH": str(tmp_path / "bin"), "EVBOTOS_SDK": str(tmp_path)}
    done = subprocess.run(
        ["sh", "-c", ". ./environment"], cwd=tmp_path, capture_output=True, text=True, check=False, env=env
    )
    assert (done.returncode, "apt-get install gcc-arm-linux-gnueabihf" in done.stderr) == (1, True)


def test_the_same_folder_gives_the_same_archive(tmp_path: Path) -> None:
    folder = tmp_path / "sdk"
    (folder / "usr").mkdir(parents=True)
    (folder / "usr/a.h").write_text("a")
    (folder / "usr/b.h").symlink_to("a.h")
    os.link(folder / "usr/a.h", folder / "usr/c.h")
    write_archive(folder, "sdk", tmp_path / "one.tar.xz", 1_700_000_000)
    os.utime(folder / "usr/a.h", (1, 1))
    (folder / "usr/a.h").chmod(0o600)
    write_archive(folder, "sdk", tmp_path / "two.tar.xz", 1_700_000_000)
    assert (tmp_path / "one.tar.xz").read_bytes() == (tmp_path / "two.tar.xz").read_bytes()
    with tarfile.open(tmp_path / "one.tar.xz") as archive:
        members = {member.name: (member.mode, member.mtime, member.isreg()) for member in archive.getmembers()}
        copy = archive.extractfile("sdk/usr/c.h")
        assert copy is not None
        assert copy.read() == b"a"
    assert members["sdk/usr/a.h"] == (0o644, 1_700_000_000, True)


def test_an_sdk_without_a_lock_file_is_told(tmp_path: Path) -> None:
    local = tmp_path / "local.yaml"
    local.write_text("version: 1\nimages: {dev: {packages: [strace]}}\n")
    with pytest.raises(BuildError, match="evbotos build raspberry-pi dev --update-lock"):
        sdk("raspberry-pi", local=local, output=tmp_path)


@pytest.mark.slow
@pytest.mark.evbotos
@pytest.mark.timeout(1500)
def test_a_module_for_arm_is_compiled_and_loaded(tmp_path: Path) -> None:
    """The SDK of the BeagleBoard: a C extension, built here, runs in that image's Python on a Cortex-A8."""
    module = built_module(load_definitions().platform("beagle-armhf"), tmp_path)
    said = subprocess.run(["readelf", "-hA", module], capture_output=True, text=True, check=True).stdout
    assert "Tag_CPU_arch: v7" in said
    assert "hard-float ABI" in said
    emulator = find_tool("qemu-arm-static") or find_tool("qemu-arm")
    if emulator is None:
        pytest.skip("qemu-user is not installed: the module's headers were examined, but nothing has loaded it")
    root = unpacked_python(tmp_path)
    program = "import platform, odometer; print(platform.machine(), odometer.distance(3, 4))"
    argv: list[str | Path] = [
        emulator,
        "-cpu",
        "cortex-a8",
        "-L",
        root,
        "-E",
        f"PYTHONPATH={tmp_path}",
        root / "usr/bin/python3.11",
        "-S",
    ]
    done = subprocess.run([*argv, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "armv7l 5.0\n"


def unpacked_python(folder: Path) -> Path:
    """Unpack the image's own C library and Python, which the SDK has left in the cache."""
    from evbotos.build import cache_folder

    found = load_definitions()
    lock = read_lock(lock_path(found.platforms["beagle-armhf"], found.images["dev"]))
    assert lock is not None
    wanted = ("libc6", "libpython3", "python3.11", "python3-minimal", "libssl3", "libexpat1", "zlib1g", "libgcc-s1")
    debs = cache_folder(found.local) / "debs"
    root = folder / "root"
    root.mkdir()
    unpack_packages([debs / f"{one.sha256}.deb" for one in lock.packages if one.name.startswith(wanted)], root)
    return root
