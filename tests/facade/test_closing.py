"""Closing many robots: what takes its time is not taken for stuck, however busy the machine is."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors import Fleet

SLOW_PLUGIN = """
import fcntl
import threading
from pathlib import Path

from eal_actors.plugin import EALPlugin, Resource


class Slow(Resource):
    def get_value(self) -> int:
        return 1

    def halt(self) -> None:
        self.note("halt")

    def close(self) -> None:
        with open(__file__) as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # one after the other
            threading.Event().wait(0.1)
        self.note("close")

    def note(self, what: str) -> None:
        with Path(__file__).with_name("log").open("a") as log:
            log.write(f"{what} {id(self)}\\n")


def connect() -> EALPlugin:
    return EALPlugin("Slow")


def disconnect(plugin: object) -> None:
    pass


def create_Slow() -> Slow:
    return Slow()


def destroy_Slow(resource: Slow) -> None:
    pass
"""


@contextlib.contextmanager
def busy_machine(programs: int) -> Iterator[None]:
    """Let programs compete for the processors."""
    command = [sys.executable, "-c", "while True: pass"]
    running = [subprocess.Popen(command) for _ in range(programs)]
    try:
        yield
    finally:
        for program in running:
            program.kill()
            program.wait()


def closed(fleet: Fleet, timeout_s: float, capsys: pytest.CaptureFixture[str]) -> str:
    """Close a fleet; return what was logged."""
    capsys.readouterr()
    fleet.close(timeout_s)
    logged = capsys.readouterr()
    return logged.out + logged.err


def fleet_of_slow_robots(folder: Path, count: int = 25) -> Path:
    """Write a fleet whose robots close one after the other; return the file."""
    plugin = folder / "slow_closing"
    plugin.mkdir()
    (plugin / "__init__.py").touch()
    (plugin / "plugin.py").write_text(SLOW_PLUGIN)
    (plugin / "plugin.yaml").write_text(
        'version: 1\nname: slow_closing\ndescription: closes slowly\nplugin_version: "1"\nresources: [Slow]\n'
    )
    file = folder / "fleet.yaml"
    file.write_text(
        f'version: 1\nplugin_dirs: [.]\nrobots: {{"r{{n}}": {{count: {count}, plugins: {{slow_closing: {{}}}}}}}}\n'
    )
    return file


def test_robots_that_close_one_after_the_other_are_not_stuck(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = fleet_of_slow_robots(tmp_path)
    before = set(threading.enumerate())
    fleet = Fleet.load(file)
    fleet.connect()
    assert all(robot["Slow"].get_value().get().value == 1 for robot in fleet.values())
    assert "stuck" not in closed(fleet, 1.0, capsys)  # 2.5 s in all
    assert set(threading.enumerate()) <= before


def test_all_robots_are_halted_before_the_first_ones_have_ended(tmp_path: Path) -> None:
    with Fleet.load(fleet_of_slow_robots(tmp_path, 60)):
        pass
    lines = (tmp_path / "slow_closing/log").read_text().splitlines()
    closed = [place for place, line in enumerate(lines) if line.startswith("close")]
    assert len(closed) == 60
    assert len({line for line in lines[: closed[3]] if line.startswith("halt")}) == 60


CLOSING = """
import sys
from eal_actors import Fleet

fleet = Fleet.load(sys.argv[1])
fleet.connect()
print("closing", flush=True)
fleet.close(1.0)
"""


FORKED = """
import os, signal
os.register_at_fork(after_in_child=lambda: signal.raise_signal(signal.SIGTERM))
from eal_actors import Fleet

with Fleet.load("sim"):
    child = os.fork()
    if not child:
        os._exit(7)
    _, status = os.waitpid(child, 0)
print(os.waitstatus_to_exitcode(status), signal.getsignal(signal.SIGTERM))
"""


def test_a_child_that_is_terminated_while_it_is_forked_ends() -> None:
    """Else `multiprocessing.Pool`, which sends the signal once, waits for it for ever."""
    ended = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, check=True)
    assert ended.stdout == f"{-signal.SIGTERM.value} {int(signal.SIG_DFL)}\n"


TROUBLE = """
from eal_actors.facade.shutdown import close_on_exit

for number in range(3):
    close_on_exit(lambda number=number: print(number, 6 // (number - 1)), print)
"""


def test_all_that_is_open_is_closed_at_exit_although_one_raises() -> None:
    ended = subprocess.run([sys.executable, "-c", TROUBLE], capture_output=True, text=True, check=False)
    assert ended.stdout == "2 6\n0 -6\n"
    assert "ZeroDivisionError" in ended.stderr


@pytest.mark.slow
def test_robots_are_not_stuck_while_their_process_gets_no_processor(tmp_path: Path) -> None:
    """It is frozen twice for longer than the limit."""
    file = fleet_of_slow_robots(tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", CLOSING, str(file)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as closing:
        assert closing.stdout is not None
        assert closing.stdout.readline() == "closing\n"
        for _ in range(2):
            closing.send_signal(signal.SIGSTOP)
            with pytest.raises(subprocess.TimeoutExpired):
                closing.wait(2.0)
            closing.send_signal(signal.SIGCONT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                closing.wait(0.5)
        logged = "".join(closing.communicate(timeout=60))
    assert "stuck" not in logged
    assert closing.returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("count", [400, 1000])
def test_many_robots_close_on_a_busy_machine(count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(
        "version: 1\n"
        f'robots: {{"r{{n}}": {{count: {count}, timeout_s: 300, plugins: {{sim: {{model: roomba, noise: false}}}}}}}}\n'
    )
    before = set(threading.enumerate())
    fleet = Fleet.load(file)
    fleet.connect()
    threads, begun_s = threading.active_count(), time.process_time()
    with busy_machine(6):
        logged = closed(fleet, 5.0, capsys)
    used_s = time.process_time() - begun_s
    print(f"{count} robots, {threads} threads: {used_s:.1f} s of a processor")  # noqa: T201  # the figure of the long form
    assert "stuck" not in logged
    assert used_s < 0.06 * count
    assert set(threading.enumerate()) <= before
