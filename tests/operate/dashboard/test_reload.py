"""The dashboard reloads the fleet file, and follows robots that come and go."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from eal_actors.facade.fleet import Fleet
from tests.operate.dashboard.rig import WAIT_S, counting_fleet, open_dashboard, page_of


def test_a_page_reloads_the_fleet_file(fleet: Fleet, tmp_path: Path) -> None:
    with open_dashboard(fleet) as dashboard:
        with page_of(dashboard) as page:
            assert page.ask(do="reload") == {"id": 1, "ok": True, "changes": "nothing changed"}
            counting_fleet(tmp_path, "one", "three")  # writes the file
            assert page.ask(do="reload")["changes"] == "added three; removed two"
            page.hear_until(lambda: page.robots.get("three") is not None and page.robots["two"] is None)
            page.hear_until(lambda: "three" in page.poses)
            assert page.ask(do="call", robot="three", resource="Base", method="get_config", text="x")["ok"] is False
            answer = page.ask(do="call", robot="three", resource="Base", method="send_cmd", text="turn5", value=None)
            assert answer["ok"]
        with page_of(dashboard) as page:
            assert page.hello["robots"] == ["one", "three"]
            page.hear_until(lambda: "three" in page.poses)
            assert "two" not in page.poses


def test_what_is_refused_is_named_by_place(fleet: Fleet, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(file.read_text() + "seed: 5\n")
    with open_dashboard(fleet) as dashboard, page_of(dashboard) as page:
        answer = page.ask(do="reload")
        assert not answer["ok"]
        assert [problem.rpartition("/")[2] for problem in answer["problems"]] == [
            "fleet.yaml:7:7: seed: 'seed' cannot change while the fleet is open; close the fleet and open it again"
        ]


def test_a_restarted_robot_is_polled_on(fleet: Fleet, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    with open_dashboard(fleet) as dashboard, page_of(dashboard) as page:
        page.hear_until(lambda: page.poses.get("two", {"at": [0]})["at"][0] > 0.5)
        file.write_text(file.read_text().replace("two: {", "two: {mailbox: 9, "))
        assert page.ask(do="reload")["changes"] == "restarted two"
        page.hear_until(lambda: page.poses["two"]["at"][0] < 0.5)  # a new resource counts from the start


def test_other_tags_of_a_robot_are_shown(fleet: Fleet, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    with open_dashboard(fleet) as dashboard, page_of(dashboard) as page:
        page.hear_until(lambda: page.robots.get("two", {}).get("tags") == [])
        file.write_text(file.read_text().replace("two: {", "two: {tags: [indoor], "))
        assert page.ask(do="reload")["changes"] == "tags two"
        page.hear_until(lambda: page.robots["two"]["tags"] == ["indoor"])


def test_a_reader_cannot_reload(fleet: Fleet) -> None:
    with open_dashboard(fleet, "secret-token") as dashboard, page_of(dashboard) as page:
        assert page.ask(do="reload")["code"] == "access_denied"


def test_the_button_in_the_browser(fleet: Fleet, tmp_path: Path, open_page: Callable[..., Any]) -> None:
    with open_dashboard(fleet) as dashboard, open_page(dashboard.link + "#/fleet") as page:
        page.set_default_timeout(WAIT_S * 1000)
        page.goto(f"{dashboard.link}#/fleet")
        page.wait_for_selector("tr[data-robot=two]")
        page.click("#reload")
        page.get_by_text("nothing changed").wait_for()
        counting_fleet(tmp_path, "one", "three")
        page.click("#reload")
        page.wait_for_selector("tr[data-robot=three]")
        page.wait_for_selector("tr[data-robot=two]", state="detached")
        file = tmp_path / "fleet.yaml"
        file.write_text(file.read_text() + "seed: 5\n")
        page.click("#reload")
        page.get_by_text("'seed' cannot change while the fleet is open").wait_for()
