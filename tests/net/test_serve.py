"""`eal serve` as a process: how it ends."""

from __future__ import annotations

import os
import pty
import termios
from contextlib import ExitStack
from pathlib import Path

from eal_actors import Fleet
from tests.net.rig import WAIT_S, Rig, ready
from tests.program import eal_processes


def test_it_ends_at_sigterm_while_its_terminal_is_paused(tmp_path: Path) -> None:
    """As by Ctrl-S: what it prints blocked it for good."""
    rig = Rig(tmp_path)
    with ExitStack() as stack:
        ends = pty.openpty()
        for end in ends:
            stack.callback(os.close, end)
        termios.tcflow(ends[1], termios.TCOOFF)
        start = stack.enter_context(eal_processes(tmp_path))
        arguments = "serve", "--fleet", rig.file, "--robot", "r1"
        server = start(*arguments, environment=os.environ, stdout=ends[1])
        stack.enter_context(ready(Fleet(rig.config)))
        server.terminate()
        assert server.wait(WAIT_S) == 0
