"""The other ends of fleets/standards.yaml: four robots that know nothing of each other, in a process each.

Three are made with packages of others: zenoh-ros2-sdk, vda5050-sdk at mosquitto, and pymavlink. The Roomba is our
emulator, behind a pair of motes at a pseudo-terminal. Each moves exactly, so its own pose is the true one.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from tests.emulated import a_roomba, plugged_in
from tests.unit.plugins.mavlink.rig import Vehicle
from tests.unit.plugins.mqtt.rig import Broker
from tests.unit.plugins.ros2.rig import PATIENCE_S, SdkRobot, free_port, ros2_peer
from tests.unit.plugins.vda5050.rig import SdkAgv

ROOMBA_START = (1.5, 1.5)
"""Where the fleet file says that the Roomba begins; its emulator begins at (0, 0)."""
_EXIT_S = 10.0

Place = tuple[float, float]


class End(NamedTuple):
    """A robot's other end.

    Attributes:
        place: returns its true place in the map, in m.
        fail: makes it fail: its radio, its connection or its cable.
        stands: returns whether it stands.
    """

    place: Callable[[], Place]
    fail: Callable[[], object]
    stands: Callable[[], bool]


class Ends(NamedTuple):
    """The robots by their names, and the variables of the fleet file."""

    robots: dict[str, End]
    variables: dict[str, str]


OpenedEnd: TypeAlias = AbstractContextManager[tuple[str, End]]
"""An end, with its address for the fleet file."""


@contextmanager
def turtle(folder: Path) -> Iterator[tuple[str, End]]:
    """Run a ROS 2 robot, and a zenoh router."""
    with ros2_peer(folder / "messages") as peer, peer, SdkRobot(peer, "/turtle") as robot:
        yield (
            peer.endpoint,
            End(lambda: robot.pose[:2], lambda: setattr(robot, "is_silent", True), lambda: robot.twist == (0.0, 0.0)),
        )


@contextmanager
def agv(folder: Path) -> Iterator[tuple[str, End]]:
    """Run an AGV, and mosquitto."""
    with Broker(folder) as broker, SdkAgv(broker, "agv-1", (1.5, 0.0, 0.0), speed_m_s=0.2) as robot:
        yield broker.url, End(lambda: robot.pose[:2], robot.lose, lambda: not robot.has_order)


@contextmanager
def rover(_: Path) -> Iterator[tuple[str, End]]:
    """Run a MAVLink rover."""
    port = free_port()
    with Vehicle(port, pose=(0.0, 1.5, 0.0)) as robot:
        yield (
            f"udp://127.0.0.1:{port}",
            End(lambda: robot.pose[:2], lambda: setattr(robot, "is_mute", True), lambda: robot.twist == (0.0, 0.0)),
        )


@contextmanager
def roomba(_: Path) -> Iterator[tuple[str, End]]:
    """Run the emulator of a Roomba."""
    with plugged_in(a_roomba()) as robot:

        def place() -> Place:
            x_m, y_m, _ = robot.body.pose
            return x_m + ROOMBA_START[0], y_m + ROOMBA_START[1]

        def stands() -> bool:
            robot.let_pass(2.0)  # its mote stops it after a second of silence
            return robot.stands()

        yield robot.address, End(place, robot.unplug, stands)


KINDS: dict[str, tuple[Callable[[Path], OpenedEnd], str]] = {
    "turtle-1": (turtle, "STANDARDS_ROUTER"),
    "agv-1": (agv, "STANDARDS_BROKER"),
    "rover-1": (rover, "STANDARDS_ROVER"),
    "roomba-1": (roomba, "STANDARDS_ROOMBA"),
}


@contextmanager
def open_ends(folder: Path) -> Iterator[Ends]:
    """Run the four robots: none waits for the interpreter of another."""
    ends = Ends({}, {})
    with ExitStack() as stack:
        for name, (make, variable) in KINDS.items():
            ends.variables[variable], ends.robots[name] = stack.enter_context(in_process(make, folder))
        yield ends


@contextmanager
def in_process(make: Callable[[Path], OpenedEnd], folder: Path) -> Iterator[tuple[str, End]]:
    """Run an end in a process of its own, which ends with this one."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(make, folder, there), daemon=True)
    process.start()
    there.close()
    try:
        yield _received(here), End(*(partial(_ask, here, name) for name in End._fields))
    finally:
        here.close()
        process.join(_EXIT_S)
        process.kill()


def _ask(pipe: Connection, name: str) -> Any:
    pipe.send(name)
    return _received(pipe)


def _received(pipe: Connection) -> Any:
    if not pipe.poll(PATIENCE_S):
        raise TimeoutError(f"an end has not answered within {PATIENCE_S:g} s")
    return pipe.recv()


def _serve(make: Callable[[Path], OpenedEnd], folder: Path, pipe: Connection) -> None:
    """Call the functions of an end that the pipe names, until it closes."""
    with make(folder) as (address, end), suppress(EOFError):
        pipe.send(address)
        while True:
            pipe.send(getattr(end, pipe.recv())())
