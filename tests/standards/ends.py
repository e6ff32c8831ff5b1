"""The other ends of fleets/standards.yaml: four robots that know nothing of each other.

Three are made with packages of others: zenoh-ros2-sdk, vda5050-sdk at mosquitto, and pymavlink. The Roomba is our
emulator, behind a pair of motes at a pseudo-terminal. Each moves exactly, so its own pose is the true one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.emulated import a_roomba, plugged_in
from tests.unit.plugins.mavlink.rig import Vehicle
from tests.unit.plugins.mqtt.rig import Broker
from tests.unit.plugins.ros2.rig import SdkRobot, free_port, ros2_peer
from tests.unit.plugins.vda5050.rig import SdkAgv

ROOMBA_START = (1.5, 1.5)
"""Where the fleet file says that the Roomba begins; its emulator begins at (0, 0)."""

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


@contextmanager
def open_ends(folder: Path) -> Iterator[Ends]:
    """Run the four robots, a zenoh router and mosquitto."""
    with ExitStack() as stack:
        peer = stack.enter_context(stack.enter_context(ros2_peer(folder / "messages")))
        broker = stack.enter_context(Broker(folder))
        port = free_port()
        turtle = stack.enter_context(SdkRobot(peer, "/turtle"))
        agv = stack.enter_context(SdkAgv(broker, "agv-1", (1.5, 0.0, 0.0), speed_m_s=0.2))
        rover = stack.enter_context(Vehicle(port, pose=(0.0, 1.5, 0.0)))
        roomba = stack.enter_context(plugged_in(a_roomba()))

        def roomba_place() -> Place:
            x_m, y_m, _ = roomba.body.pose
            return x_m + ROOMBA_START[0], y_m + ROOMBA_START[1]

        def roomba_stands() -> bool:
            roomba.let_pass(2.0)  # its mote stops it after a second of silence
            return roomba.stands()

        robots = {
            "turtle-1": End(
                lambda: turtle.pose[:2], lambda: setattr(turtle, "is_silent", True), lambda: turtle.twist == (0.0, 0.0)
            ),
            "agv-1": End(lambda: agv.pose[:2], agv.lose, lambda: not agv.has_order),
            "rover-1": End(
                lambda: rover.pose[:2], lambda: setattr(rover, "is_mute", True), lambda: rover.twist == (0.0, 0.0)
            ),
            "roomba-1": End(roomba_place, roomba.unplug, roomba_stands),
        }
        variables = {
            "STANDARDS_ROUTER": peer.endpoint,
            "STANDARDS_BROKER": broker.url,
            "STANDARDS_ROVER": f"udp://127.0.0.1:{port}",
            "STANDARDS_ROOMBA": roomba.address,
        }
        yield Ends(robots, variables)
