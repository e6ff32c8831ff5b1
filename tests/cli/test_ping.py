"""`eal ping`, `eal stop` and `eal resume` with robots served in this process."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import StoppedError
from eal_actors.managers.config import EALConfigManager
from tests.net.links import eventually, free_port

Serve = Callable[..., dict[str, RobotService]]


@pytest.fixture
def fleet(slides: Path) -> Path:
    """A fleet of two robots with an address, and one without."""
    text = slides.read_text(encoding="utf-8")
    for name in ("one", "two"):
        text = text.replace(f"  {name}: {{", f"  {name}: {{address: 'tcp/127.0.0.1:{free_port()}', ")
    slides.write_text(f"{text}  here: {{plugins: {{slide: {{}}}}}}\n", encoding="utf-8")
    return slides


@pytest.fixture
def serve(fleet: Path) -> Iterator[Serve]:
    """Serve robots of the fleet."""
    with ExitStack() as stack:

        def start(*robots: str) -> dict[str, RobotService]:
            config = EALConfigManager.load(fleet).fleet
            return {robot: stack.enter_context(RobotService(config, robot)) for robot in robots}

        yield start


def row(text: str, robot: str) -> str:
    (line,) = [line for line in text.splitlines() if line.split()[:1] == [robot]]
    return line


class TestPing:
    def test_a_robot_that_is_there_is_measured(self, eal: Any, fleet: Path, serve: Serve) -> None:
        serve("one")
        result = eal("ping", "--fleet", fleet, "--count", 3, "--json", "one")
        assert result.exit_code == 0
        answer = json.loads(result.stdout)
        (robot,) = answer["robots"]
        assert answer["fleet"] == "slides"
        assert (robot["name"], robot["ready"], robot["state"], robot["answers"]) == ("one", True, "ready", 3)
        assert (robot["resources"], robot["stopped"], robot["holders"], robot["reason"]) == (1, None, {}, None)
        assert 0 < robot["round_trip_min_s"] <= robot["round_trip_median_s"] < 1
        assert abs(robot["clock_offset_s"]) <= robot["clock_offset_error_s"] < 0.5  # it is the same clock
        assert robot["release"]

    def test_a_local_one_is_left_alone_and_an_absent_one_tells_why(self, eal: Any, fleet: Path, serve: Serve) -> None:
        serve("one")
        result = eal("ping", "--fleet", fleet, "--count", 1)
        assert result.exit_code == 1
        assert "ready" in row(result.stdout, "one")
        assert "0.1.0" in row(result.stdout, "one")
        assert row(result.stdout, "one").split()[-1] == "1"
        assert "lost" in row(result.stdout, "two")
        address = EALConfigManager.load(fleet).fleet.robots["two"].address
        described = json.loads(eal("ping", "--fleet", fleet, "--count", 1, "--json").stdout)["robots"]
        two, here = described[1:]
        assert f"does not answer at {address}" in two["reason"]
        assert (two["ready"], two["answers"], two["round_trip_min_s"], two["release"]) == (False, 0, None, None)
        assert (here["state"], here["ready"], here["address"]) == ("local", True, None)

    def test_who_holds_an_actuator_is_shown(self, eal: Any, fleet: Path, serve: Serve) -> None:
        serve("one")
        with Fleet.load(fleet).connect(["one"]) as controller:
            controller["one"]["Slide"].send_cmd("to0.01").get()
            result = eal("ping", "--fleet", fleet, "--count", 1, "--json", "one")
            (holder,) = json.loads(result.stdout)["robots"][0]["holders"].items()
            assert holder[0] == "Slide"
            assert (
                f"one: Slide is held by controller {holder[1]}\n"
                in eal("ping", "--fleet", fleet, "--count", 1, "one").stdout
            )
        assert json.loads(eal("ping", "--fleet", fleet, "--json", "one").stdout)["robots"][0]["holders"] == {}

    def test_a_fleet_of_local_robots_is_ready(self, eal: Any, fleet: Path) -> None:
        result = eal("ping", "--fleet", fleet, "here")
        assert result.exit_code == 0
        assert row(result.stdout, "here").split()[1] == "local"
        assert "here: runs in the controller's process\n" in result.stdout

    def test_an_unknown_robot_is_wrong_input(self, eal: Any, fleet: Path) -> None:
        assert eal("ping", "--fleet", fleet, "onee").exit_code == 2


class TestStop:
    def test_a_stop_holds_until_it_is_resumed(self, eal: Any, fleet: Path, serve: Serve) -> None:
        served = serve("one", "two")
        with Fleet.load(fleet).connect(["one", "two"]) as controller:
            drive = controller["one"]["Slide"].send_cmd("to1")
            assert eventually(lambda: served["one"].robot["Slide"].get_status().get() == 1)
            result = eal("stop", "--fleet", fleet, "--reason", "a dog", "one", "two")
            assert result.exit_code == 0
            assert sorted(result.stdout.splitlines()) == ["2 of 2 stopped", "one  stopped", "two  stopped"]
            assert drive.exception(timeout=10) is not None
            for robot in controller.values():
                error = robot["Slide"].send_cmd("to0.1").exception(timeout=10)
                assert isinstance(error, StoppedError)
                assert "a dog" in str(error)

            shown = eal("ping", "--fleet", fleet, "--count", 1, "one")
            assert shown.exit_code == 0
            assert row(shown.stdout, "one").split()[1] == "stopped"
            assert "one: emergency stop: a dog\n" in shown.stdout

            result = eal("resume", "--fleet", fleet, "--json", "one", "two")
            assert result.exit_code == 0
            assert json.loads(result.stdout) == {
                "fleet": "slides",
                "robots": [{"name": name, "confirmed": True, "reason": None} for name in ("one", "two")],
            }
            assert served["one"].robot.stopped_because is None

    def test_who_does_not_confirm_is_told_and_delays_nobody(self, eal: Any, fleet: Path, serve: Serve) -> None:
        served = serve("two")
        result = eal("stop", "--fleet", fleet)
        assert result.exit_code == 1
        assert served["two"].robot.stopped_because == "no reason given"
        lines = result.stdout.splitlines()
        assert lines[0] == "two  stopped"
        assert lines[1].startswith("one  not stopped: did not answer within 3 s at tcp/127.0.0.1:")
        assert lines[2] == "here  not stopped: runs in its controller's process: only that process can stop it"
        assert lines[3:] == ["1 of 3 stopped, one, here NOT CONFIRMED"]

    def test_in_json_too(self, eal: Any, fleet: Path) -> None:
        result = eal("stop", "--fleet", fleet, "--json", "here")
        assert result.exit_code == 1
        (robot,) = json.loads(result.stdout)["robots"]
        assert (robot["name"], robot["confirmed"]) == ("here", False)
        resumed = eal("resume", "--fleet", fleet, "here").stdout
        assert "here  not resumed: runs in its controller's process: only that process can resume it\n" in resumed
