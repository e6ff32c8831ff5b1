"""Libraries without what nobody reads still load, and hold all that somebody reads."""

from __future__ import annotations

import ast
import shutil
import struct
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.fields import ROOTFS
from evbotos.project import project_files
from evbotos.pruning import left_out
from evbotos.slimming import drop_languages, drop_spare_libraries, strip_libraries, strip_library, without_languages

ITEMS = {
    "icudt72l/coll/ucadata.icu": b"order",
    "icudt72l/de.res": b"Sprache",
    "icudt72l/ibm-37.cnv": b"bytes",
    "icudt72l/zu.res": b"last",
}


def needed_by(library: Path) -> list[str]:
    told = subprocess.run(["readelf", "-d", "-W", library], capture_output=True, text=True, check=True).stdout
    return [line.partition("[")[2] for line in told.splitlines() if "(NEEDED)" in line]


@pytest.mark.skipif(shutil.which("readelf") is None, reason="binutils are not installed")
def test_compiled_wheels_load_without_their_symbols(tmp_path: Path) -> None:
    spec = find_spec("pymunk")
    assert spec is not None
    assert spec.origin is not None
    original = next(Path(spec.origin).parent.glob("_chipmunk*.so"))
    copy = Path(shutil.copy(original, tmp_path))
    removed = strip_libraries(tmp_path)
    assert removed == original.stat().st_size - copy.stat().st_size > 1_000_000
    assert needed_by(copy) == needed_by(original) != []
    program = f"""
import importlib.util
spec = importlib.util.spec_from_file_location("_chipmunk", {str(copy)!r})
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
print(module.lib.cpMomentForCircle(2.0, 0.0, 3.0, module.ffi.new("cpVect *")[0]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stdout == "9.0\n", done.stderr
    assert strip_libraries(tmp_path) == 0


def test_a_library_of_a_32_bit_board_ends_with_its_last_segment() -> None:
    header = b"\x7fELF\x01\x01\x01" + bytes(9)
    header += struct.pack("<HHIIIIIHHHHHH", 3, 40, 1, 0, 52, 200, 0, 52, 32, 1, 40, 5, 4)
    segment = struct.pack("<IIIIIIII", 1, 0, 0, 0, 120, 120, 5, 4096)
    stripped = strip_library(header + segment + bytes(36) + b"symbols")
    assert len(stripped) == 120
    assert struct.unpack_from("<I", stripped, 32) == (0,)
    assert struct.unpack_from("<HHH", stripped, 46) == (40, 0, 0)


@pytest.mark.parametrize("content", [b"", b"#!/bin/sh", b"\x7fELF\x02\x02" + bytes(100)])
def test_other_files_are_refused(content: bytes) -> None:
    with pytest.raises(BuildError):
        strip_library(content)


def data_of_icu() -> bytes:
    names = b"".join(name.encode() + b"\0" for name in ITEMS)
    entries, name_at = b"", 4 + 8 * len(ITEMS)
    data_at = name_at + len(names)
    for name, content in ITEMS.items():
        entries += struct.pack("<II", name_at, data_at)
        name_at, data_at = name_at + len(name) + 1, data_at + len(content)
    header = struct.pack("<H", 32) + b"\xda\x27" + bytes(8) + b"CmnD" + bytes(16)
    return b"\x7fELF" + header + struct.pack("<I", len(ITEMS)) + entries + names + b"".join(ITEMS.values()) + b"end"


def test_encodings_stay_and_languages_go() -> None:
    data = data_of_icu()
    kept = without_languages(data)
    assert len(kept) == len(data)
    assert b"bytes" in kept
    assert b"icudt72l/de.res" in kept
    assert b"order" not in kept
    assert b"Sprache" not in kept
    with pytest.raises(BuildError):
        without_languages(b"\x7fELF of another kind")


@pytest.mark.parametrize("sorts", [False, True])
def test_who_sorts_by_language_keeps_the_data(tmp_path: Path, sorts: bool) -> None:
    folder = tmp_path / "usr/lib/x86_64-linux-gnu"
    folder.mkdir(parents=True)
    (folder / "libicudata.so.72.1").write_bytes(data_of_icu())
    (folder / "libicudata.so.72").symlink_to("libicudata.so.72.1")
    if sorts:
        (folder / "libicui18n.so.72").touch()
    drop_languages(tmp_path)
    assert (b"Sprache" in (folder / "libicudata.so.72").read_bytes()) is sorts


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_libraries_go_unless_a_program_or_a_linker_needs_them(tmp_path: Path) -> None:
    folder = tmp_path / "usr/lib/x86_64-linux-gnu"
    folder.mkdir(parents=True)
    for name in ("libzstd", "libexpatw", "libother"):
        library = folder / f"{name}.so.1.2"
        subprocess.run(["gcc", "-shared", f"-Wl,-soname,{name}.so.1", "-o", library, "-xc", "/dev/null"], check=True)
        (folder / f"{name}.so.1").symlink_to(library.name)
    (tmp_path / "usr/bin").mkdir()
    options = ["-Wl,--no-as-needed", f"-L{folder}", "-l:libzstd.so.1"]
    subprocess.run(["gcc", "-shared", "-o", tmp_path / "usr/bin/git", "-xc", "/dev/null", *options], check=True)
    (folder / "libmvec.so.1").touch()
    (folder / "libtic.so.6").touch()
    (folder / "libm.so").write_text("GROUP ( libm.so.6 AS_NEEDED ( libmvec.so.1 ) )")
    drop_spare_libraries(tmp_path)
    kept = ["libm.so", "libmvec.so.1", "libother.so.1", "libother.so.1.2", "libzstd.so.1", "libzstd.so.1.2"]
    assert sorted(path.name for path in folder.iterdir()) == kept


def imported(source: Path) -> set[str]:
    """Return the modules of Python that a program imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module is not None:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {name for name in names if name.partition(".")[0] in sys.stdlib_module_names}


@pytest.mark.parametrize("name", ["robot", "wireless", "vision", "libcamera", "octave-robot", "dev"])
def test_what_robots_import_of_python_stays(name: str) -> None:
    image = load_definitions().image(name)
    programs = [path for _, path in project_files() if path.suffix == ".py"]
    programs += ROOTFS.glob("**/usr/lib/evbotos/*.py")
    modules = {module.replace(".", "/") for program in programs for module in imported(program)}
    paths = [f"usr/lib/python3.11/{module}{end}" for module in sorted(modules) for end in (".py", "/__init__.py")]
    assert len(paths) > 200
    assert left_out(paths, image.prune, image.keep) == []
