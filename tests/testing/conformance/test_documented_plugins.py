"""The plugins of docs/plugins.md, taken from the page as they stand, pass every check."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from eal_actors.testing.conformance import CHECKS, Bench, run_checks, settings_of

PAGE: Final = (Path(__file__).parents[3] / "docs/plugins.md").read_text(encoding="utf-8")

NO_DEVICE: Final = {
    check.name: (check.nothing,)
    for check in CHECKS
    if check.name in ("estimates its pose", "waits for its device", "survives unplugging")
}
"""Plugins without an emulator skip these."""

TANK: Final = """

def connect():
    return EALPlugin("Base")


def disconnect(plugin):
    pass


def create_Base():
    return Base()


def destroy_Base(resource):
    pass
"""


def block(language: str, start: str) -> str:
    """Return the page's only code block of a language with such a beginning."""
    found = re.findall(rf"```{language}\n({re.escape(start)}.*?)```", PAGE, re.DOTALL)
    (text,) = found
    return str(text)


def check(folder: Path, manifest: str, code: str, more: Mapping[str, str] | None = None) -> dict[str, tuple[str, ...]]:
    """Write a plugin and return the problems of its checks, and why some were skipped."""
    folder.mkdir()
    for name, text in {"plugin.yaml": manifest, "plugin.py": code, **(more or {})}.items():
        (folder / name).write_text(text, encoding="utf-8")
    results = run_checks(Bench(folder, settings_of({})))
    return {result.check.name: result.problems for result in results if result.outcome != "ok"}


def test_the_lift_conforms(tmp_path: Path) -> None:
    code = block("python", '"""A lift that takes its time')
    assert check(tmp_path / "lift", block("yaml", "# plugin.yaml"), code) == NO_DEVICE


def test_the_tank_conforms(tmp_path: Path) -> None:
    code = block("python", "import math\n\nfrom eal_actors.plugin import").partition("\nbase = Base()")[0]
    code = code.replace("import Activity, ", "import Activity, EALPlugin, ") + TANK
    manifest = 'version: 1\nname: tank\ndescription: A tank.\nplugin_version: "1"\nresources: [Base]\n'
    assert check(tmp_path / "tank", manifest, code) == NO_DEVICE


SERVO: Final = '''\
"""A servo of Dynamixel, by its vendor's pages "DYNAMIXEL Protocol 2.0" and "XL430-W250"."""

import struct

PING, READ, WRITE, STATUS = 1, 2, 3, 0x55
HEADER = b"\\xff\\xff\\xfd\\x00"
STEPS_A_S = 2000


def crc16(data):
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


class Emulator:
    def __init__(self):
        self.complaints = []
        self.buffer = b""
        self.table = bytearray(256)
        self.at_s = None

    def feed(self, data, now_s):
        self.advance(now_s)
        self.buffer += data
        reply = b""
        while (start := self.buffer.find(HEADER)) >= 0 and len(self.buffer) >= start + 7:
            (length,) = struct.unpack_from("<H", self.buffer, start + 5)
            end = start + 7 + length
            if len(self.buffer) < end:
                break
            packet, self.buffer = self.buffer[start:end], self.buffer[end:]
            reply += self.answer(packet)
        return reply

    def advance(self, now_s):
        position, goal = self.number(132), self.number(116)
        step = 0 if self.at_s is None else int((now_s - self.at_s) * STEPS_A_S)
        if step or self.at_s is None:
            self.at_s = now_s
        self.table[132:136] = struct.pack("<i", position + max(-step, min(step, goal - position)))

    def number(self, address):
        return struct.unpack_from("<i", self.table, address)[0]

    def answer(self, packet):
        if packet[-2:] != struct.pack("<H", crc16(packet[:-2])) or packet[4] != 1:
            self.complaints.append(packet.hex())
            return b""
        instruction, numbers, content = packet[7], packet[8:-2], b""
        if instruction == PING:
            content = struct.pack("<HB", 1060, 45)  # model and firmware
        elif instruction == READ:
            address, count = struct.unpack("<HH", numbers)
            content = bytes(self.table[address : address + count])
        elif instruction == WRITE:
            (address,) = struct.unpack_from("<H", numbers)
            self.table[address : address + len(numbers) - 2] = numbers[2:]
        body = HEADER + struct.pack("<BHBB", 1, len(content) + 4, STATUS, 0) + content
        return body + struct.pack("<H", crc16(body))


def emulate(settings, now_s):
    return Emulator()
'''


def test_the_servo_of_a_vendor_s_library_conforms(tmp_path: Path) -> None:
    manifest = (
        'version: 1\nname: servo\ndescription: A servo.\nplugin_version: "1"\nresources: [Joint]\n'
        'emulator: {wire: pty, settings: {port: "{address}"}}\nrequires: [dynamixel_sdk]\n'
    )
    code = block("python", '"""A servo of Dynamixel, through the library')
    assert check(tmp_path / "servo", manifest, code, {"emulator.py": SERVO}) == {
        "estimates its pose": ("it has no Pose that estimates",),
        "keeps configuration": ("no configuration key is writable",),
    }
