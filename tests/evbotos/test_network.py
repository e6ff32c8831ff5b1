"""The image's network at the other end of its cable: addresses, name, time."""

from __future__ import annotations

from collections.abc import Iterator
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path

import pytest
from scapy.layers.dns import DNS
from scapy.layers.inet import ICMP, IP
from scapy.layers.l2 import ARP
from scapy.layers.ntp import NTPHeader
from scapy.packet import Packet

from eal_actors.kernel.clock import wall_time
from tests.evbotos.proof import LONGEST_BOOT_S, Proof, started
from tests.evbotos.wire import OUR_IP, ROBOT_IP, Wire

LINK_LOCAL = IPv4Network("169.254.0.0/16")
OWN_LINK_LOCAL = "169.254.53.86"
"""The initial address of the machine, derived from its network card's address, 52:54:00:12:34:56."""
NAME = "evbot-123456.local."
HOURS_AHEAD = 3
DAY_S = 86_400.0

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.fixture
def wire() -> Iterator[Wire]:
    wire = Wire()
    yield wire
    wire.close()


def named(frame: Packet) -> str | None:
    """Return the address that a frame answers the robot's name with, if it does."""
    if DNS not in frame or not frame[DNS].qr:
        return None
    return next((str(one.rdata) for one in frame[DNS].an or () if one.type == 1 and one.rrname.decode() == NAME), None)


def test_a_name_and_an_address_of_its_own_until_somebody_gives_one(proof: Proof, disk: Path, wire: Wire) -> None:
    wire.gives_addresses = False
    wire.taken.add(OWN_LINK_LOCAL)
    with started(proof, disk, network=wire.network):
        probe = wire.first(lambda frame: ARP in frame and frame[ARP].pdst == OWN_LINK_LOCAL, LONGEST_BOOT_S)
        assert probe is not None
        assert probe[ARP].psrc == "0.0.0.0"  # noqa: S104  # it asks before it uses the address (RFC 5227)
        told = wire.first(lambda frame: named(frame) is not None, LONGEST_BOOT_S, lambda: wire.ask_name(NAME))
        assert told is not None
        address = named(told)
        assert address == told[IP].src != OWN_LINK_LOCAL
        assert IPv4Address(address) in LINK_LOCAL

        wire.gives_addresses = True
        told = wire.first(lambda frame: named(frame) == ROBOT_IP, LONGEST_BOOT_S, lambda: wire.ask_name(NAME))
        assert told is not None
        assert told[IP].src == ROBOT_IP


def test_an_address_that_a_renewed_lease_changes_replaces_the_former(proof: Proof, disk: Path, wire: Wire) -> None:
    wire.lease_s = 20

    def has(address: str, within_s: float) -> bool:
        def is_it(frame: Packet) -> bool:
            return ARP in frame and frame[ARP].op == 2 and frame[ARP].psrc == address

        return wire.first(is_it, within_s, lambda: wire.ask_address(address)) is not None

    with started(proof, disk, network=wire.network):
        assert has(ROBOT_IP, LONGEST_BOOT_S)
        wire.address = "192.0.2.8"
        assert has("192.0.2.8", LONGEST_BOOT_S)
        assert not has(ROBOT_IP, 10)


def test_its_clock_is_set_by_the_server_that_dhcp_names(proof: Proof, disk: Path, wire: Wire) -> None:
    wire.ahead_s = HOURS_AHEAD * 3600
    with started(proof, disk, network=wire.network):
        asked = wire.first(lambda frame: NTPHeader in frame, LONGEST_BOOT_S)
        assert asked is not None
        assert asked[IP].dst == OUR_IP

        def is_right(frame: Packet) -> bool:
            if ICMP not in frame or frame[ICMP].type != 14:
                return False
            wanted_s = (wall_time().timestamp() + wire.ahead_s) % DAY_S
            off_s: float = abs(frame[ICMP].ts_tx / 1000 - wanted_s)
            return min(off_s, DAY_S - off_s) < 60.0

        assert wire.first(is_right, LONGEST_BOOT_S, lambda: wire.ask_time(asked.src)) is not None
