"""Leave the engine before the interpreter ends.

CPython before 3.14 ends a daemon thread that returns to Python during finalization, by unwinding its stack. The engine
catches that as a foreign exception, and the C library aborts the process: "FATAL: exception not rethrown", SIGABRT. A
program that received messages ended so in 40 of 40 tries with an open session, and in 4 of 40 with a closed one.

So, after the fleets are closed, open sessions are closed, no thread enters the engine any more, and the program waits
until all have left. A thread is in the engine while its innermost Python frame is code that calls the engine; looking
at the frames at the end costs the calls nothing. Readers of messages go on until their session is closed, since its
end waits for an engine's thread that a full channel holds up.

An object of the engine enters the engine once more when it is freed. A thread that ends frees its last references
without a frame of its own, so the program also waits for the ends of the threads of this package, and keeps the objects
that are still in use. For the same reason no callback runs in the engine's threads: before it begins it has no frame.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Final

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.log import get_logger
from eal_actors.wire.own_sockets import refuse_lookups

has_begun = False
"""Whether the program ends: nothing is sent any more, and messages are thrown away."""
is_over = False
"""Whether all sessions are closed, so that no thread may enter the engine."""

IS_A_FORK: Final = (
    "this process is a fork, which lacks the threads of its parent: "
    'start it with multiprocessing.get_context("spawn"), and open the fleet in it'
)
"""Why a child of `os.fork` cannot use the network or the fleets of its parent."""

_TIMEOUT_S: Final = 25.0
"""Real seconds after which the program ends nevertheless. The end of a session waits for TLS handshakes under way, up
to 20 s each: with 5 s, a program whose emulated robots did not answer ended by SIGABRT."""
_PERIOD_S: Final = 0.001
_LOOK_S: Final = 0.05
_CALLERS: Final = str(Path(__file__).parent)
_actions: dict[Callable[[], None], None] = {}
_threads: weakref.WeakSet[threading.Thread] = weakref.WeakSet()
_owners: weakref.WeakSet[object] = weakref.WeakSet()
_kept: list[object] = []


def start_thread(work: Callable[[], None], name: str) -> threading.Thread:
    """Start a daemon thread that calls the engine; the program waits for its end. Thread: any."""
    thread = threading.Thread(target=work, name=name, daemon=True)
    _threads.add(thread)
    thread.start()
    return thread


def keep_at_exit(owner: object) -> None:
    """Keep an owner of the engine's objects, if it is still in use when the program ends. Thread: any."""
    _owners.add(owner)


def close_at_exit(close: Callable[[], None]) -> Callable[[], object]:
    """Close a session when the program ends; return a function that undoes this. Thread: any."""
    _actions[close] = None
    return lambda: _actions.pop(close, None)


@atexit.register  # facade.shutdown imports this module, so that its own handler runs before this one
def _leave() -> None:
    global has_begun, is_over
    has_begun = True
    _kept.extend(_owners)
    for close in list(_actions):
        close()
    is_over = True
    end_s = REAL_TIME.now() + _TIMEOUT_S
    for thread in list(_threads):
        _join(thread, end_s)
    while names := _threads_inside():
        if REAL_TIME.now() > end_s:
            get_logger().warning("threads are still in the network engine; the program ends", threads=names)
            return
        REAL_TIME.sleep(_PERIOD_S)


def _join(thread: threading.Thread, end_s: float) -> None:
    """Wait for a thread, whose session may wait for a slow name server. Thread: blocks the caller, until `end_s`."""
    while (left_s := end_s - REAL_TIME.now()) > 0:
        thread.join(min(left_s, _LOOK_S))
        if not thread.is_alive():
            return
        refuse_lookups()  # those of other threads too: the program has ended


if hasattr(os, "register_at_fork"):  # a child has neither sessions nor threads to wait for
    os.register_at_fork(after_in_child=_actions.clear)
    os.register_at_fork(after_in_child=_threads.clear)


def _threads_inside() -> list[str]:
    """Return the names of the daemon threads in the engine; the interpreter itself waits for the others."""
    frames = sys._current_frames()  # noqa: SLF001  # its documented use: where all threads are
    inside = {number for number, frame in frames.items() if frame.f_code.co_filename.startswith(_CALLERS)}
    return [thread.name for thread in threading.enumerate() if thread.daemon and thread.ident in inside]
