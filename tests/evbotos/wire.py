"""The other end of an emulated network card's cable: real frames, and a server for addresses, names and time on it."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import closing

from scapy.layers.dhcp import BOOTP, DHCP
from scapy.layers.dns import DNS, DNSQR
from scapy.layers.inet import ICMP, IP, UDP
from scapy.layers.l2 import ARP, Ether
from scapy.layers.ntp import NTPHeader
from scapy.packet import Packet

from eal_actors.kernel.clock import REAL_TIME, wall_time

OUR_MAC = "52:54:00:00:00:01"
OUR_IP = "192.0.2.1"
ROBOT_IP = "192.0.2.7"
MDNS_IP, MDNS_MAC, MDNS_PORT = "224.0.0.251", "01:00:5e:00:00:fb", 5353
_NTP_EPOCH_S = 2_208_988_800
_NTP_ORIGIN, _NTP_SENT = slice(24, 32), slice(40, 48)
_ASK_EVERY_S = 2.0


class Wire:
    """A cable that ends here: QEMU sends each frame as a datagram, and takes such ones.

    Attributes:
        network: what QEMU plugs the card into, as `-netdev` names it.
        gives_addresses: whether somebody answers DHCP here.
        address: what they give.
        lease_s: for how long.
        taken: addresses of other machines on the wire.
        ahead_s: how much later than now it is by the time server here.
    """

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
            other.bind(("127.0.0.1", 0))
            self._card = other.getsockname()
        self.network = f"socket,udp=127.0.0.1:{self._socket.getsockname()[1]},localaddr=127.0.0.1:{self._card[1]}"
        self.gives_addresses = True
        self.address = ROBOT_IP
        self.lease_s = 3600
        self.taken: set[str] = set()
        self.ahead_s = 0.0

    def close(self) -> None:
        """Pull the cable out."""
        self._socket.close()

    def send(self, packet: Packet, mac: str) -> None:
        """Put a packet on the wire."""
        self._socket.sendto(bytes(Ether(src=OUR_MAC, dst=mac) / packet), self._card)

    def first(
        self, is_it: Callable[[Packet], bool], within_s: float, asking: Callable[[], None] = lambda: None
    ) -> Packet | None:
        """Return the first frame of a kind, or None; meanwhile the servers here do their work.

        Args:
            is_it: tells whether a frame is the one.
            within_s: real seconds.
            asking: called at first, and every two seconds.
        """
        end_s = REAL_TIME.now() + within_s
        while REAL_TIME.now() < end_s:
            asking()
            for frame in self._frames(_ASK_EVERY_S):
                if is_it(frame):
                    return frame
        return None

    def ask_name(self, name: str) -> None:
        """Ask everybody on the wire who has a name (RFC 6762)."""
        question = DNS(rd=0, qd=DNSQR(qname=name, qtype="A"))
        source = IP(src=OUR_IP, dst=MDNS_IP, ttl=255)
        self.send(source / UDP(sport=MDNS_PORT, dport=MDNS_PORT) / question, MDNS_MAC)

    def ask_address(self, address: str) -> None:
        """Ask everybody on the wire who has an address (RFC 826)."""
        self.send(ARP(op=1, hwsrc=OUR_MAC, psrc=OUR_IP, pdst=address), "ff:ff:ff:ff:ff:ff")

    def ask_time(self, mac: str) -> None:
        """Ask the robot's kernel for its time of day (RFC 792)."""
        self.send(IP(src=OUR_IP, dst=ROBOT_IP) / ICMP(type="timestamp-request"), mac)

    def _frames(self, for_s: float) -> Iterator[Packet]:
        end_s = REAL_TIME.now() + for_s
        while (left_s := end_s - REAL_TIME.now()) > 0:
            self._socket.settimeout(left_s)
            try:
                frame = Ether(self._socket.recv(2048))
            except TimeoutError:
                return
            self._serve(frame)
            yield frame

    def _serve(self, frame: Packet) -> None:
        if ARP in frame and frame[ARP].op == 1 and frame[ARP].pdst in {OUR_IP, *self.taken}:
            asked = frame[ARP]
            answer = ARP(op=2, hwsrc=OUR_MAC, psrc=asked.pdst, hwdst=asked.hwsrc, pdst=asked.psrc)
            self.send(answer, frame.src)
        elif DHCP in frame and self.gives_addresses:
            self._give_address(frame)
        elif NTPHeader in frame and frame[IP].dst == OUR_IP:
            self._tell_time(frame)

    def _give_address(self, frame: Packet) -> None:
        asked = frame[BOOTP]
        wanted = next(option[1] for option in frame[DHCP].options if option[0] == "message-type")
        options = [
            ("message-type", "offer" if wanted == 1 else "ack"),
            ("server_id", OUR_IP),
            ("lease_time", self.lease_s),
            ("subnet_mask", "255.255.255.0"),
            ("NTP_server", OUR_IP),
            "end",
        ]
        answer = BOOTP(op=2, xid=asked.xid, yiaddr=self.address, siaddr=OUR_IP, chaddr=asked.chaddr) / DHCP(
            options=options
        )
        self.send(IP(src=OUR_IP, dst="255.255.255.255") / UDP(sport=67, dport=68) / answer, frame.src)

    def _tell_time(self, frame: Packet) -> None:
        now_s = wall_time().timestamp() + _NTP_EPOCH_S + self.ahead_s
        answer = NTPHeader(version=4, mode=4, stratum=2, ref_id=OUR_IP, ref=now_s, recv=now_s, sent=now_s)
        told = bytearray(bytes(answer))
        told[_NTP_ORIGIN] = bytes(frame[NTPHeader])[_NTP_SENT]  # to the bit: it is a random number, and checked
        self.send(IP(src=OUR_IP, dst=frame[IP].src) / UDP(sport=123, dport=frame[UDP].sport) / bytes(told), frame.src)
