"""A frame of 921,600 bytes from a robot on the same machine, in shared memory and over its link, beside raw TCP.

Run as `python -m tests.benchmarks.shared_memory`. The robots and the TCP server run in processes of their own, and all
take turns.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from eal_actors import Fleet
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from tests.benchmarks.network import timed
from tests.benchmarks.peers.tcp import TcpClient
from tests.net.links import free_port
from tests.net.rig import Rig, ready, servers

ROUNDS: Final = 9
FRAMES: Final = 20
SERVE_TCP: Final = """
import sys
from tests.benchmarks.peers.tcp import TcpServer
server = TcpServer(int(sys.argv[1]))
print("up", flush=True)
server.serve_forever()
"""


def robot_frames(stack: ExitStack, folder: Path, protocol: str, *, shared: bool) -> Callable[[], object]:
    """Serve a robot in a process of its own; return what reads a frame of it."""
    folder.mkdir()
    network: dict[str, object] = {"shared_memory": shared}
    if protocol == "tls":
        make_authority(folder / "keys", "f")
        make_certificate(folder / "keys", "r1", ["127.0.0.1"])
        make_certificate(folder / "keys", "controller")
        network["security"] = {"roles": {"controllers": ["controller"]}}
    rig = Rig(folder, network=network, protocol=protocol)
    stack.enter_context(servers(rig))
    eye = stack.enter_context(ready(Fleet(rig.config)))["r1"]["Eye"]
    return lambda: eye.get_value().get()


def main() -> None:
    """Print the medians of the ratios to raw TCP, and their range over the rounds."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        port = free_port()
        server = subprocess.Popen([sys.executable, "-c", SERVE_TCP, str(port)], stdout=subprocess.PIPE)
        stack.callback(server.kill)
        assert server.stdout is not None
        server.stdout.readline()
        tcp = TcpClient(port)
        ways = {
            f"{protocol}, {'shared memory' if shared else 'link'}": robot_frames(
                stack, folder / f"{protocol}{shared}", protocol, shared=shared
            )
            for protocol in ("tcp", "tls")
            for shared in (True, False)
        }
        ratios: dict[str, list[float]] = {name: [] for name in ways}
        for number in range(ROUNDS + 1):
            raw_s = statistics.median(timed(tcp.frame) for _ in range(FRAMES))
            for name, read in ways.items():
                ratio = statistics.median(timed(read) for _ in range(FRAMES)) / raw_s
                if number:  # in the first round the memory is offered
                    ratios[name].append(ratio)
        for name, found in ratios.items():
            spread = f"{min(found):.2f} to {max(found):.2f}"
            sys.stdout.write(f"{name:20} {statistics.median(found):.2f} times raw TCP ({spread})\n")


if __name__ == "__main__":
    main()
