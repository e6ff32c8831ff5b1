"""Rules for all tests: no thread may outlive its test; the order of files, the number of workers, and repetitions."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pykka
import pytest
from hypothesis import settings

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.log import get_logger
from tests.stalls import StallWatch

# A busy machine misses deadlines, and a failure must be repeatable: no deadline, the same examples in every run.
settings.register_profile("patient", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None)  # `pytest --hypothesis-profile search` looks for new ones
settings.load_profile("patient")

# Tests start hundreds of programs: let them share compiled modules.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A shell ignores SIGINT for background programs, and nohup ignores SIGHUP; their children inherit that.
# A handler is not inherited: they begin with the default, while this process still survives a closed terminal.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)

LONG: Final = (
    *("evbotos", "docs", "house", "soak", "scenarios", "testing"),
    *("fuzz", "net", "faults", "cli", "security", "operate"),
)
"""Folders with slow files, the slowest first, so that no worker ends with a slow file of its own."""


@pytest.hookimpl(optionalhook=True)  # with `-p no:xdist` nobody calls it
def pytest_xdist_auto_num_workers() -> int:
    """Return one more than there are processors: tests often wait, but real-time ones stall beside too many others."""
    return len(os.sched_getaffinity(0)) + 1


STALLS: Final = StallWatch()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    STALLS.restart()
    get_logger()  # sets logging up; else structlog's capture_logs does, with its defaults, for all tests after it


def _may_be_repeated() -> bool:
    """Return whether a failure may say nothing about the code; the summary lists each repetition."""
    return "CI" in os.environ or STALLS.has_stalled()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        item.add_marker(pytest.mark.flaky(reruns=1, condition=_may_be_repeated))
    here = Path(__file__).parent

    def rank(item: pytest.Item) -> int:
        folder = item.path.relative_to(here).parts[0]
        return LONG.index(folder) if folder in LONG else len(LONG)

    items.sort(key=rank)


_LEFT_OUT: Final[dict[str, int]] = {}
_JOIN_S: Final = 5.0
"""Real time that the threads of a test have to end, all together: a hang leaves hundreds."""
"""How many tests were deselected, by the make target that runs them."""


def pytest_deselected(items: list[pytest.Item]) -> None:
    for marker in ("evbotos", "slow"):  # a slow test of evbotos counts once
        marked = [item for item in items if item.get_closest_marker(marker) is not None]
        items = [item for item in items if item not in marked]
        if marked:
            _LEFT_OUT[f"make test-{marker}"] = len(marked)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):  # a worker's, which the terminal does not show
        session.config.workeroutput["left_out"] = _LEFT_OUT


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    _LEFT_OUT.update(getattr(node, "workeroutput", {}).get("left_out", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for target, count in _LEFT_OUT.items():
        terminalreporter.write_line(f"{count} tests were left out: `{target}` runs them")


@pytest.fixture(autouse=True)
def no_leaked_threads() -> Iterator[None]:
    """Fail a test that leaves threads or actors behind, naming them."""
    before = set(threading.enumerate())
    yield
    compiled = threading._DummyThread  # a library's own thread that has called Python: it cannot be joined
    left = [thread for thread in threading.enumerate() if thread not in before and not isinstance(thread, compiled)]
    end_s = REAL_TIME.now() + _JOIN_S
    for thread in left:
        thread.join(max(0.0, end_s - REAL_TIME.now()))
    alive = [thread.name for thread in left if thread.is_alive()]
    actors = [str(ref) for ref in pykka.ActorRegistry.get_all()]
    pykka.ActorRegistry.stop_all(block=False)
    assert not alive, f"threads left behind: {alive}"
    assert not actors, f"actors left behind: {actors}"
