"""Packet filters for listening TCP sockets: the kernel drops the packets of new connections by their IP address.

Links that exist have sockets of their own, which no filter touches.

Source: Linux, Documentation/networking/filter.rst (classic BPF).
"""

from __future__ import annotations

import ctypes
import ipaddress
import socket
import struct
from typing import Final, NamedTuple

MAX_ADDRESSES: Final = 16
"""Addresses of each IP version in a filter; a jump of classic BPF passes 255 instructions."""
_SO_ATTACH_FILTER: Final = 26
_SO_DETACH_FILTER: Final = 27
_NET: Final = 0xFFF00000  # SKF_NET_OFF: an offset in the IP header
_LOAD_BYTE: Final = 0x30  # BPF_LD | BPF_B | BPF_ABS
_LOAD_WORD: Final = 0x20  # BPF_LD | BPF_W | BPF_ABS
_SHIFT_RIGHT: Final = 0x74  # BPF_ALU | BPF_RSH | BPF_K
_JUMP_IF_EQUAL: Final = 0x15  # BPF_JMP | BPF_JEQ | BPF_K
_RETURN: Final = 0x06  # BPF_RET | BPF_K
_ALL: Final = 0xFFFFFFFF
_SOURCE_V4: Final = 12
_SOURCE_V6: Final = 8
_Instruction = tuple[int, int, int, int]
_DROP: Final[_Instruction] = (_RETURN, 0, 0, 0)
_PASS: Final[_Instruction] = (_RETURN, 0, 0, _ALL)


class PacketRule(NamedTuple):
    """Which packets of new connections pass, by IP addresses; the first MAX_ADDRESSES of each version count.

    Packets from these are dropped and all others pass if `are_dropped`; else these pass and all others are dropped.
    """

    addresses: tuple[str, ...]
    are_dropped: bool


def filter_packets(listener: socket.socket, rule: PacketRule) -> None:
    """Drop packets of new connections, by a rule that replaces the present one."""
    program = b"".join(struct.pack("HBBI", *instruction) for instruction in _program(rule))
    kept = ctypes.create_string_buffer(program, len(program))
    filter_program = struct.pack("HP", len(program) // 8, ctypes.addressof(kept))
    listener.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, filter_program)


def pass_packets(listener: socket.socket) -> None:
    """Remove the filter."""
    listener.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)


def plain_address(text: str) -> str:
    """Return an IP address without its zone, and as IPv4 if it is mapped to IPv6; ValueError if it is none."""
    address = ipaddress.ip_address(text.partition("%")[0])
    return str(getattr(address, "ipv4_mapped", None) or address)


def _program(rule: PacketRule) -> list[_Instruction]:
    listed, others = (_DROP, _PASS) if rule.are_dropped else (_PASS, _DROP)
    addresses = [ipaddress.ip_address(text) for text in rule.addresses]
    v4 = [address.packed for address in addresses if address.version == 4][:MAX_ADDRESSES]
    v6 = [address.packed for address in addresses if address.version == 6][:MAX_ADDRESSES]
    of_v4 = [line for address in v4 for line in _if_source(address, _SOURCE_V4, listed)] + [others]
    of_v6 = [line for address in v6 for line in _if_source(address, _SOURCE_V6, listed)] + [others]
    version = [(_LOAD_BYTE, 0, 0, _NET), (_SHIFT_RIGHT, 0, 0, 4), (_JUMP_IF_EQUAL, 0, len(of_v4), 4)]
    return version + of_v4 + of_v6


def _if_source(address: bytes, offset: int, verdict: _Instruction) -> list[_Instruction]:
    """Return instructions that end with a verdict on a packet from an address, and continue behind them otherwise."""
    words = struct.unpack(f">{len(address) // 4}I", address)
    lines: list[_Instruction] = []
    for number, word in enumerate(words):
        behind = 2 * (len(words) - number) - 1
        lines += [(_LOAD_WORD, 0, 0, _NET + offset + 4 * number), (_JUMP_IF_EQUAL, 0, behind, word)]
    return [*lines, verdict]
