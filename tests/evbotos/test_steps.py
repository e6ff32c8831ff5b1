from __future__ import annotations

import os
import select
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

import evbotos.steps as steps_module
from evbotos.errors import BuildError, DiskFullError
from evbotos.hashing import files_sha256, key_of
from evbotos.shell import run
from evbotos.steps import Runner, Step, owned, place


def write(path: Path, text: str) -> None:
    path.write_text(text)


def test_a_step_is_made_once(tmp_path: Path) -> None:
    told: list[str] = []
    step = Step("one", "key", lambda out: write(out, "made"))
    for _ in range(2):
        assert Runner(tmp_path, told.append).run(step).read_text() == "made"
    assert told == ["one"]


@pytest.mark.parametrize("is_noted", [True, False])
def test_a_result_that_has_changed_in_the_cache_is_made_again(tmp_path: Path, is_noted: bool) -> None:
    told: list[str] = []

    def make(out: Path) -> None:
        out.mkdir()
        (out / "kernel").write_text("made")

    step, runner = Step("one", "key", make), Runner(tmp_path, told.append)
    runner.run(step)
    if not is_noted:  # as in the cache of an earlier version, which noted no digests
        (tmp_path / "digests/one-key").unlink()
        runner.run(step)
    (runner.outcome(step) / "kernel").write_text("mage")
    assert (runner.run(step) / "kernel").read_text() == "made"
    assert told[1:-1] == [f"warning: {runner.outcome(step)} has changed since it was made; it is made again"]


def test_a_step_says_how_long_the_last_one_of_its_name_took(tmp_path: Path) -> None:
    told: list[str] = []
    runner = Runner(tmp_path, told.append)
    for number, (name, key) in enumerate((("one", "a"), ("one-more", "b"))):
        runner.run(Step(name, key, lambda out: write(out, "made")))
        note = tmp_path / "seconds" / f"{name}-{key}"
        note.write_text(f"{300 + number}.2\n")
        os.utime(note, (number, number))
    runner.run(Step("one", "c", lambda out: write(out, "made")))
    assert told == ["one", "one-more", "one (about 300 s, as the last time)"]


def test_a_step_of_a_build_says_its_number_and_how_long_the_rest_took(tmp_path: Path) -> None:
    told: list[str] = []
    for lock in ("old", "new"):
        runner = Runner(tmp_path, told.append, ("one", "two", "three"))
        for name in runner.names:
            runner.run(Step(name, lock, lambda out: write(out, "made")))
            (tmp_path / "seconds" / f"{name}-{lock}").write_text("30.4\n")
    assert told[:3] == ["one, 1 of 3", "two, 2 of 3", "three, 3 of 3"]
    assert told[3] == "one, 1 of 3 (about 30 s, as the last time; at most about 61 s for the rest)"
    assert told[5] == "three, 3 of 3 (about 30 s, as the last time)"


def test_a_step_that_fails_leaves_nothing_and_is_made_anew(tmp_path: Path) -> None:
    runner = Runner(tmp_path, lambda _: None)

    def half(out: Path) -> None:
        out.mkdir()
        (out / "half").write_text("")
        raise OSError("Input/output error")

    with pytest.raises(BuildError, match="step one: Input/output error"):
        runner.run(Step("one", "key", half))
    assert not any((tmp_path / "one").iterdir())
    assert runner.run(Step("one", "key", lambda out: out.mkdir())).is_dir()


def test_a_full_disk_is_told_as_such(tmp_path: Path) -> None:
    def fill(_: Path) -> None:
        run(["dd", "if=/dev/zero", "of=/dev/full", "count=1"])

    with pytest.raises(DiskFullError, match="step one: dd failed: the disk is full; free space"):
        Runner(tmp_path, lambda _: None).run(Step("one", "key", fill))


def test_a_killed_build_leaves_nothing_that_counts(tmp_path: Path) -> None:
    program = (
        "import os, sys\nfrom pathlib import Path\nfrom evbotos.steps import *\n"
        "def make(out):\n    out.mkdir()\n    (out / 'half').write_text('')\n    os.kill(os.getpid(), 9)\n"
        "cache = Path(sys.argv[1])\n"
        "with owned(cache):\n    Runner(cache, print).run(Step('one', 'key', make))\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False, capture_output=True)
    assert done.returncode == -9, done.stderr.decode()
    assert [path.name for path in (tmp_path / "one").iterdir()] == [".part-key"]
    with owned(tmp_path):
        assert not any((tmp_path / "one").iterdir())
        outcome = Runner(tmp_path, lambda _: None).run(Step("one", "key", lambda out: write(out, "whole")))
    assert outcome.read_text() == "whole"


def kill(builder: psutil.Process) -> None:
    builder.kill()


def terminate_by_name(builder: psutil.Process) -> None:
    """Like `pkill -f`."""
    named = [one for one in builder.children(recursive=True) if one.cmdline() == builder.cmdline()]
    assert named, "the guard has another name"
    for process in (*named, builder):
        process.terminate()


@pytest.mark.parametrize("end", [kill, terminate_by_name])
def test_what_a_program_has_started_ends_with_a_killed_build(
    tmp_path: Path, end: Callable[[psutil.Process], None]
) -> None:
    os.mkfifo(tmp_path / "alive")
    inner = f"exec 3>{tmp_path}/alive; echo started >&3; exec sleep 1000"
    program = f"from evbotos.shell import run\nrun(['sh', '-c', 'sh -c \"{inner}\" & wait'])\n"
    builder = subprocess.Popen([sys.executable, "-c", program])
    with (tmp_path / "alive").open("rb", buffering=0) as alive:
        assert alive.readline() == b"started\n"
        end(psutil.Process(builder.pid))
        builder.wait()
        assert select.select([alive], [], [], 60)[0], "the started program runs on"
        assert alive.read() == b""


def test_two_builds_do_not_share_a_cache(tmp_path: Path) -> None:
    with owned(tmp_path), pytest.raises(BuildError, match="another build uses"), owned(tmp_path):
        pytest.fail("two owners")
    with owned(tmp_path):
        assert (tmp_path / "lock").exists()


def test_keys_follow_inputs_and_code() -> None:
    assert key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})
    assert key_of({"a": 1}) != key_of({"a": 2})
    assert key_of({"a": 1}) != key_of({"a": 1}, steps_module)


def test_the_hash_of_files_follows_names_contents_modes_and_links(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_text("1")
    seen = {files_sha256([("a", file)]), files_sha256([("b", file)])}
    file.chmod(0o755)
    seen.add(files_sha256([("a", file)]))
    file.write_text("2")
    seen.add(files_sha256([("a", file)]))
    (tmp_path / "link").symlink_to("a")
    seen.add(files_sha256([("a", tmp_path / "link")]))
    assert len(seen) == 5


def test_a_file_is_placed_whole_over_another(tmp_path: Path) -> None:
    (tmp_path / "new").write_text("new")
    (tmp_path / "old").write_text("old")
    place(tmp_path / "new", tmp_path / "old")
    assert (tmp_path / "old").read_text() == "new"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "old"]


def test_a_full_disk_is_told_in_a_sentence_also_where_a_tree_is_copied(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in ("one", "two"):
        (source / name).write_text("content")

    def make(out: Path) -> None:
        shutil.copytree(source, out, copy_function=lambda one, _: shutil.copyfile(one, "/dev/full"))

    with pytest.raises(DiskFullError) as caught:
        Runner(tmp_path, lambda _: None).run(Step("root", "k", make))
    assert caught.value.message == (
        f"step root: the disk of {tmp_path} is full; free space and build again, finished steps are kept"
    )


def test_many_problems_of_a_copy_are_told_by_the_first(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    for name in ("one", "two"):
        (tmp_path / "source" / name).symlink_to("missing")

    def make(out: Path) -> None:
        shutil.copytree(tmp_path / "source", out)

    with pytest.raises(BuildError, match=r"step root: \S+: .*No such file or directory.*, and 1 more"):
        Runner(tmp_path, lambda _: None).run(Step("root", "k", make))


def test_a_cached_step_knows_how_long_it_took_to_make(tmp_path: Path) -> None:
    for is_cached in (False, True):
        runner = Runner(tmp_path, lambda _: None)
        runner.run(Step("kernel", "k", lambda out: write(out, "made")))
        (done,) = runner.done
        assert (done.cached, done.made_s is not None) == (is_cached, True)
    (tmp_path / "seconds/kernel-k").write_text("749.4\n")
    runner.run(Step("kernel", "k", lambda _: pytest.fail("made anew")))
    assert runner.done[-1].made_s == 749.4
