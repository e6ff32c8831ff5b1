"""The doctor's judgements of facts, without a machine."""

from __future__ import annotations

import errno
import os
import struct
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.device.serial_ports import usb_id
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.manifest import discover
from eal_actors.operate.doctor.certificates import RequiredCertificate, judge_mode, judge_validity
from eal_actors.operate.doctor.clocks import judge_date, judge_steps, judge_synchronised
from eal_actors.operate.doctor.devices import (
    DeviceFacts,
    NamedDevice,
    judge_camera,
    judge_device,
    named_devices,
    read_facts,
)
from eal_actors.operate.doctor.diagnostic import Severity
from eal_actors.operate.doctor.packages import judge_python, judge_requirements
from eal_actors.operate.doctor.ports import judge_port
from eal_actors.operate.doctor.robots import judge_ping

PORT = NamedDevice("one", Path("/dev/ttyUSB7"), kind="serial")
EYE = NamedDevice("one", Path("/dev/video3"), kind="camera", group="video")
THERE = DeviceFacts(exists=True, is_device=True, usable=True, group="dialout")
NOW = datetime(2026, 6, 1, tzinfo=UTC)


class TestPackages:
    @pytest.mark.parametrize(
        ("version", "level"),
        [
            ((3, 11, 0), Severity.OK),
            ((3, 12, 1), Severity.OK),
            ((3, 10, 9), Severity.PROBLEM),
            ((4, 0, 0), Severity.OK),
        ],
    )
    def test_python(self, version: tuple[int, ...], level: Severity) -> None:
        assert judge_python(version, ">=3.11").level is level

    def test_everything_in_its_bounds_is_one_line(self) -> None:
        wanted = ["pykka<5,>=4.5", "ruamel.yaml>=1.0", "psutil>=6; extra == 'system'"]
        (finding,) = judge_requirements(wanted, {"pykka": "4.5", "ruamel-yaml": "1.0.0rc1"})
        assert (finding.level, finding.what) == (Severity.OK, "pykka 4.5, ruamel.yaml 1.0.0rc1")

    def test_what_is_too_old_too_new_or_missing_is_named_with_its_remedy(self) -> None:
        wanted = ["pykka<5,>=4.5", "typer>=0.20", "rich>=14"]
        findings = list(judge_requirements(wanted, {"pykka": "5.0", "typer": "0.9.4"}))
        assert [finding.level for finding in findings] == [Severity.PROBLEM] * 3
        assert [finding.what for finding in findings] == [
            "pykka is 5.0, not <5,>=4.5",
            "typer is 0.9.4, not >=0.20",
            "rich is not installed",
        ]
        assert findings[2].advice == "pip install 'rich>=14'"


class TestClock:
    def test_a_date_before_the_framework_is_wrong(self) -> None:
        (finding,) = judge_date(datetime(1970, 1, 1, 0, 5, tzinfo=UTC))
        assert finding.level is Severity.PROBLEM
        assert list(judge_date(NOW)) == []

    def test_a_time_server_is_wanted_where_the_system_tells(self) -> None:
        levels = [judge_synchronised(answer).level for answer in (True, False, None)]
        assert levels == [Severity.OK, Severity.WARNING, Severity.OK]

    def test_a_step_either_way_is_told_with_its_size(self) -> None:
        assert list(judge_steps(0.09)) == []
        assert "-3.5 s" in next(judge_steps(-3.5)).what


class TestDevices:
    def test_a_usable_one_is_fine(self) -> None:
        assert judge_device(PORT, THERE, "eva").level is Severity.OK

    def test_an_absent_one_names_what_is_there(self) -> None:
        finding = judge_device(PORT, DeviceFacts(exists=False), "eva", ["/dev/ttyUSB0"])
        assert finding.level is Severity.PROBLEM
        assert "There is /dev/ttyUSB0." in finding.advice

    @pytest.mark.parametrize(
        ("facts", "advice"),
        [
            (
                DeviceFacts(True, True, None, False, "dialout"),
                "sudo usermod -aG dialout eva; then log out and in again.",
            ),
            (DeviceFacts(True, True, None, False, "video", is_member=True), "log out and in again"),
            (DeviceFacts(True, True, None, False, ""), "udev rule"),
            (DeviceFacts(True, False, None, True, ""), "Name the device itself"),
        ],
    )
    def test_what_keeps_us_out_has_its_remedy(self, facts: DeviceFacts, advice: str) -> None:
        finding = judge_device(PORT, facts, "eva")
        assert finding.level is Severity.PROBLEM
        assert advice in finding.advice

    def test_facts_of_real_files(self, tmp_path: Path) -> None:
        assert read_facts(Path("/dev/null")).usable
        assert read_facts(Path("/dev/null")).is_device
        assert not read_facts(tmp_path / "nothing").exists
        (tmp_path / "file").write_text("")
        assert not read_facts(tmp_path / "file").is_device

    def test_devices_are_found_in_settings_whatever_the_plugin(self, tmp_path: Path) -> None:
        file = tmp_path / "f.yaml"
        file.write_text(
            "version: 1\nrobots:\n"
            "  one: {plugins: {camera: {source: 3}, own: {wires: [{port: /dev/ttyUSB7}, 4], speed: 9600}}}\n"
            "  two: {plugins: {serial_port: {port: 'socket://host:1'}, camera: {source: rtsp://eye}}}\n"
        )
        assert named_devices(EALConfigManager.load(file).fleet.robots.values(), discover([])[0]) == [
            EYE,
            replace(PORT, kind="other"),
        ]

    def test_a_device_is_found_by_its_usb_id(self, tmp_path: Path) -> None:
        number = Path("/dev/null").stat().st_rdev
        device = tmp_path / "devices/usb1/1-1/1-1:1.0/ttyUSB0"
        device.mkdir(parents=True)
        (tmp_path / "devices/usb1/1-1/idVendor").write_text("0403\n")
        (tmp_path / "devices/usb1/1-1/idProduct").write_text("6001\n")
        (tmp_path / "dev/char").mkdir(parents=True)
        (tmp_path / f"dev/char/{os.major(number)}:{os.minor(number)}").symlink_to(device)
        assert usb_id(Path("/dev/null"), tmp_path) == "0403:6001"
        assert usb_id(Path("/dev/zero"), tmp_path) is None

    @pytest.mark.parametrize(
        ("whole", "own", "level"),
        [
            (0x84A00001, 0x04200001, Severity.OK),  # what a usual USB camera answers for its first device
            (0x84A00001, 0x04A00000, Severity.WARNING),  # and for its second, which gives metadata
            (0x00000001, 0, Severity.OK),  # a driver from before devices told of themselves
        ],
    )
    def test_a_camera_is_known_by_its_capabilities(self, whole: int, own: int, level: Severity) -> None:
        answer = struct.pack("=16s32s32sIII12x", b"uvcvideo", b"HD Eye", b"usb-1", 0x60000, whole, own)
        assert len(answer) == 104
        finding = judge_camera(EYE, answer)
        assert finding.level is level
        assert "HD Eye" in finding.what

    def test_what_has_no_capabilities_is_no_camera(self) -> None:
        assert judge_camera(EYE, None).level is Severity.PROBLEM


class TestCertificates:
    @pytest.mark.parametrize(
        ("begins_days", "ends_days", "levels"),
        [
            (-100, 31, []),
            (-800, 29, [Severity.WARNING]),
            (-8, 3, []),  # in the last fifth of its lifetime only
            (-100, 0, [Severity.PROBLEM]),
            (1, 900, [Severity.PROBLEM]),
        ],
    )
    def test_validity(self, begins_days: int, ends_days: int, levels: list[Severity]) -> None:
        wanted = RequiredCertificate("one", "eal keys renew one")
        begins, ends = NOW + timedelta(days=begins_days), NOW + timedelta(days=ends_days)
        assert [finding.level for finding in judge_validity(wanted, begins, ends, NOW)] == levels

    @pytest.mark.parametrize(("mode", "count"), [(0o600, 0), (0o400, 0), (0o640, 1), (0o604, 1), (0o620, 1)])
    def test_a_key_is_for_its_owner_alone(self, mode: int, count: int) -> None:
        assert len(list(judge_mode(Path("one.key"), mode))) == count


class TestPorts:
    def test_one_that_is_served_and_one_that_is_free_are_fine(self) -> None:
        assert judge_port("one", "tcp/127.0.0.1:5", is_served=True, error=None).level is Severity.OK
        assert judge_port("one", "tcp/127.0.0.1:5", is_served=False, error=None).level is Severity.OK

    @pytest.mark.parametrize(
        ("code", "level", "advice"),
        [
            (errno.EADDRINUSE, Severity.PROBLEM, "sport = :5000"),
            (errno.EACCES, Severity.PROBLEM, "1024"),
            (errno.EADDRNOTAVAIL, Severity.WARNING, "listen"),
        ],
    )
    def test_why_it_cannot_be_had(self, code: int, level: Severity, advice: str) -> None:
        finding = judge_port("one", "tcp/[::1]:5000", is_served=False, error=OSError(code, "x"))
        assert finding.level is level
        assert advice in finding.advice


class TestRobots:
    def test_one_of_our_release_is_fine(self) -> None:
        (finding,) = judge_ping("one", Ping(RobotState.READY, "1.0", 3), "1.0")
        assert finding.level is Severity.OK

    def test_everything_unusual_is_told(self) -> None:
        ping = Ping(RobotState.READY, "0.9", 3, stopped="fire", round_trip_s=0.25, not_ready={"Base": "unplugged"})
        findings = list(judge_ping("one", ping, "1.0"))
        assert [finding.level for finding in findings] == [Severity.WARNING] * 4
        told = " ".join(finding.what for finding in findings)
        assert all(word in told for word in ("release 0.9", "fire", "one/Base is not ready: unplugged", "250 ms"))

    def test_a_failed_one_is_a_problem(self) -> None:
        (finding,) = judge_ping("one", Ping(RobotState.FAILED, "1.0", 0), "1.0")
        assert finding.level is Severity.PROBLEM
