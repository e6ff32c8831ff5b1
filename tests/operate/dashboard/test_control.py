"""Control of resources: how the page shows it and when it is released, with robots that others command too."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import process_name
from eal_actors.kernel.errors import ResourceBusyError
from eal_actors.operate.dashboard.control import IDLE_S, WHOLE, ControlRegistry
from tests.manual_clock import ManualClock
from tests.net.links import eventually
from tests.net.rig import Rig, failure, ready
from tests.operate.dashboard.rig import counting_fleet, open_dashboard, page_of


class TestControl:
    """The registry alone, with a manual clock."""

    def test_control_ends_a_while_after_the_last_command(self) -> None:
        clock = ManualClock()
        control = ControlRegistry(clock)
        control.acquire("one", "Base", "browser 1")
        control.acquire("one", "Base", "browser 2")
        control.done("one", "Base")
        clock.advance(10 * IDLE_S)
        assert control.users("one") == {"Base": "browser 2"}  # one command is still running
        control.done("one", "Base")
        clock.advance(IDLE_S * 0.9)
        assert control.users("one") == {"Base": "browser 2"}
        clock.advance(IDLE_S * 0.2)
        assert control.users("one") == {}
        assert control.by("one", "Base") == "browser 2"

    def test_a_scenario_has_the_whole_robot(self) -> None:
        control = ControlRegistry(ManualClock())
        control.acquire("one", "Base", "browser 1")
        control.done("one", "Base")
        control.acquire("one", WHOLE, "scenario dance")
        assert control.by("one", "Base") == "scenario dance"
        assert control.by("one", "Arm") == "scenario dance"
        assert control.by("two", "Base") is None


@contextmanager
def served(tmp_path: Path) -> Iterator[tuple[Fleet, Fleet]]:
    """The fleet of a dashboard and that of another controller, both at the end of real links to one robot."""
    rig = Rig(tmp_path)
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as other:
        yield fleet, other


def test_others_may_command_a_resource_a_moment_after_the_page(tmp_path: Path) -> None:
    with served(tmp_path) as (fleet, other), open_dashboard(fleet) as dashboard, page_of(dashboard) as page:
        arm = other["r1"]["Arm"]
        assert page.ask(do="call", robot="r1", resource="Arm", method="send_cmd", text="step1")["ok"] is True
        failure(arm.send_cmd("step2"), ResourceBusyError)
        page.hear_until(lambda: page.robots["r1"]["control"] == {"Arm": page.hello["you"]})
        page.hear_until(lambda: page.robots["r1"]["control"] == {})
        assert arm.send_cmd("step3").get() == 3


def test_a_resource_with_a_running_command_is_not_released(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eal_actors.operate.dashboard.control.IDLE_S", 0.0)
    with served(tmp_path) as (fleet, other), open_dashboard(fleet) as dashboard, page_of(dashboard) as page:
        page.say(
            do="call", id=900, heard_s=page.heard_s(), robot="r1", resource="Arm", method="send_cmd", text="move30"
        )
        page.hear_until(lambda: bool(page.robots.get("r1", {}).get("running")))
        pings = [fleet["r1"].ping().get() for _ in range(3)]
        assert all(ping.holder_ids == {"Arm": fleet["r1"].controller_id} for ping in pings)
        failure(other["r1"]["Arm"].send_cmd("step1"), ResourceBusyError)
        fleet["r1"].halt().get()
        assert eventually(lambda: other["r1"]["Arm"].send_cmd("step2").exception() is None)


def test_the_page_shows_another_controller_and_its_commands(tmp_path: Path) -> None:
    with served(tmp_path) as (fleet, other), open_dashboard(fleet) as dashboard, page_of(dashboard) as page:
        move = other["r1"]["Arm"].send_cmd("move30")
        page.hear_until(lambda: bool(page.robots.get("r1", {}).get("running")))
        page.hear_until(lambda: page.robots["r1"]["control"] == {"Arm": process_name()})
        page.hear_until(lambda: page.robots["r1"]["running"][0]["by"] == process_name())
        (running,) = page.robots["r1"]["running"]
        assert (running["resource"], running["command"]) == ("Arm", "move30")
        move.cancel()
        page.hear_until(lambda: page.robots["r1"]["running"] == [])


def test_the_page_shows_the_progress_of_a_command(tmp_path: Path) -> None:
    with (
        counting_fleet(tmp_path, "one").connect() as fleet,
        open_dashboard(fleet) as dashboard,
        page_of(dashboard) as page,
    ):
        far = fleet["one"]["Base"].send_cmd("far", timeout_s=3600)  # not by the page
        page.hear_until(lambda: bool(page.robots.get("one", {}).get("running")))
        (running,) = page.robots["one"]["running"]
        assert (running["command"], running["by"]) == ("far", None)
        assert (running["progress"]["fraction"], running["progress"]["text"]) == (0.25, "a quarter")
        far.cancel()
