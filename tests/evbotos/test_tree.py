from __future__ import annotations

import stat
from pathlib import Path

import pytest

from evbotos.errors import BuildError
from evbotos.fields import ROOTFS
from evbotos.pruning import left_out, pattern_to_regex, prune_tree
from evbotos.sizes import group_of, sizes_of
from evbotos.tree import busybox_applets, normalise, overlay


@pytest.mark.parametrize(
    ("pattern", "path", "fits"),
    [
        ("usr/share/**", "usr/share/doc/a/b", True),
        ("usr/share/**", "usr/shared/a", False),
        ("usr/*/a", "usr/lib/a", True),
        ("usr/*/a", "usr/lib/x/a", False),
        ("**/*.pyi", "a.pyi", True),
        ("**/*.pyi", "a/b/c.pyi", True),
        ("usr/bin/{a,b*}", "usr/bin/bc", True),
        ("usr/bin/{a,b*}", "usr/bin/ac", False),
        ("lib/[ab].so", "lib/b.so", True),
        ("a.b", "axb", False),
    ],
)
def test_patterns(pattern: str, path: str, fits: bool) -> None:
    assert bool(pattern_to_regex(pattern).fullmatch(path)) is fits


def test_what_is_kept_is_not_left_out() -> None:
    assert left_out(["a/b", "a/c", "d"], ["a/**"], ["a/c"]) == ["a/b"]


def test_pruning_removes_files_and_the_folders_that_this_empties(tmp_path: Path) -> None:
    for name in ("usr/share/doc/a", "usr/lib/a", "empty/b"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("12345")
    (tmp_path / "usr/share/link").symlink_to("nowhere")
    (tmp_path / "was-empty").mkdir()
    assert prune_tree(tmp_path, ["usr/share/**", "empty/b"], []) == 10
    left = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*"))
    assert left == ["usr", "usr/lib", "usr/lib/a", "was-empty"]


def test_an_overlay_keeps_links_and_modes_and_replaces_files(tmp_path: Path) -> None:
    source, root = tmp_path / "source", tmp_path / "root"
    (source / "etc").mkdir(parents=True)
    (source / "etc/run").write_text("new")
    (source / "etc/run").chmod(0o755)
    (source / "etc/link").symlink_to("/run/x")
    (root / "etc").mkdir(parents=True)
    (root / "etc/run").write_text("old")
    overlay(source, root)
    assert (root / "etc/run").read_text() == "new"
    assert (root / "etc/run").stat().st_mode & stat.S_IXUSR
    assert (root / "etc/link").readlink() == Path("/run/x")


def test_modes_do_not_depend_on_the_umask(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    (tmp_path / "a").chmod(0o600)
    (tmp_path / "b").write_text("")
    (tmp_path / "b").chmod(0o711)
    normalise(tmp_path)
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in "ab"] == [0o644, 0o755]


def test_busyboxs_commands_are_read_from_any_architectures_program() -> None:
    names = ["[", "[[", *sorted([f"c{number:03d}" for number in range(120)] + ["init", "mount", "sh"])]
    program = b"\x7fELF...\0" + b"\0".join(name.encode() for name in names) + b"\0BusyBox\0other\0"
    assert busybox_applets(program) == names


def test_a_program_that_is_no_busybox_is_refused() -> None:
    with pytest.raises(BuildError, match="list of commands"):
        busybox_applets(b"\x7fELF" + b"\0" * 100)


def test_sizes_are_counted_by_what_people_know(tmp_path: Path) -> None:
    assert group_of("usr/lib/python3/dist-packages/numpy/core/a.so") == "python: numpy"
    assert group_of("usr/lib/python3/dist-packages/typing_extensions.pyc") == "python: typing_extensions"
    assert group_of("usr/lib/python3.11/json/a.pyc") == "python: standard library"
    assert group_of("usr/lib/x86_64-linux-gnu/libc.so.6") == "library: libc"
    assert group_of("usr/bin/busybox") == "program: busybox"
    (tmp_path / "usr/bin").mkdir(parents=True)
    (tmp_path / "usr/bin/a").write_bytes(bytes(1000))
    ((plain, packed),) = sizes_of(tmp_path).values()
    assert plain == 1000
    assert packed < 100


def test_the_files_of_the_root_have_no_link_without_a_target() -> None:
    """Packages of this project and OpenEmbedded's build copy what links point to."""
    assert not [str(path) for path in ROOTFS.rglob("*") if path.is_symlink() and not path.exists()]
