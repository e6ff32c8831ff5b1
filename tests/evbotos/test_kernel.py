"""The compilation of a kernel, with a source that has a makefile and nothing else."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from eal_actors.kernel.clock import REAL_TIME
from evbotos import kernel
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.model import Kernel
from evbotos.shell import run

KERNEL = Kernel(
    source="linux-source-6.1", architecture="x86_64", fragments=("common.config",), image="arch/x86_64/boot/Image"
)
MAKEFILE = """
tinyconfig:
\ttouch .config
olddefconfig:
Image: object
\techo $$$$ >compiler; test -e may-end || sleep 30
\tmkdir -p arch/x86_64/boot && cp objects arch/x86_64/boot/Image
object:
\techo compiled >>objects
\ttouch object
"""
CONTROL = """Package: linux-source-6.1
Version: 1
Architecture: all
Maintainer: nobody <nobody@example.org>
Description: a kernel with a makefile
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A package as Debian's kernel source, whose kernel takes as long as no file `may-end` is in its folder."""
    missing = [name for name in ("dpkg-deb", "make", "tar", "xz") if find_tool(name) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (make evbotos-setup)")
    package, tree = tmp_path / "package", tmp_path / "linux-source-6.1"
    for folder in (tree, package / "usr/src", package / "DEBIAN"):
        folder.mkdir(parents=True)
    (tree / "Makefile").write_text(MAKEFILE)
    (package / "DEBIAN/control").write_text(CONTROL)
    run(["tar", "-cJf", package / "usr/src/linux-source-6.1.tar.xz", "-C", tmp_path, tree.name])
    run(["dpkg-deb", "--build", "--root-owner-group", package, tmp_path / "source.deb"])
    shutil.rmtree(tree)
    return tmp_path / "source.deb"


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


def test_the_limit_of_a_compilation_ends_the_compiler_and_the_next_build_resumes(
    tmp_path: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert kernel._LONGEST_S == 24 * 3600
    monkeypatch.setattr(kernel, "_LONGEST_S", 2.0)
    monkeypatch.setattr(kernel, "fragments_text", lambda _: "")
    work, out = tmp_path / "work", tmp_path / "out"
    work.mkdir()
    with pytest.raises(BuildError, match="make was killed: it took longer than 2 s"):
        kernel.build_kernel(KERNEL, source, out, work)
    assert not out.exists()
    (tree,) = work.glob("*/linux-source-6.1")
    compiler = int((tree / "compiler").read_text())
    end_s = REAL_TIME.now() + 60
    while is_running(compiler) and REAL_TIME.now() < end_s:
        REAL_TIME.sleep(0.05)
    assert not is_running(compiler)

    monkeypatch.setattr(kernel, "_LONGEST_S", 60.0)
    (tree / "may-end").touch()
    (tree / "Makefile").write_text(MAKEFILE.replace("echo compiled", "echo compiled again"))
    kernel.build_kernel(KERNEL, source, out, work)
    assert (out / "Image").read_text() == "compiled\n"
    assert sorted(path.name for path in out.iterdir()) == ["Image", kernel.CONFIG]
    assert not any(work.iterdir())
