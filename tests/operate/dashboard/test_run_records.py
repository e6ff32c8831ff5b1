"""A run from the page leaves the same record as `eal run`, and the page links to its report."""

from __future__ import annotations

import http.client
from pathlib import Path

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard import Dashboard
from eal_actors.recording import RunFolder
from tests.operate.dashboard.rig import SIM, WAIT_S, counting_fleet, open_dashboard, page_of
from tests.scenario_texts import scenario_of

TURN = scenario_of("send_cmd: {resource: Base, cmd: r20}", name="turn")
KEPT = {
    "events.jsonl",
    "fleet.yaml",
    "report.html",
    "run.mcap",
    "scenario.yaml",
    "summary.json",
    "trajectory.csv",
    "trajectory.png",
    "versions.json",
    "world.yaml",
}


def get(dashboard: Dashboard, path: str) -> tuple[int, str, str]:
    """Return the status, the content security policy and the body of a GET."""
    connection = http.client.HTTPConnection("127.0.0.1", dashboard.port, timeout=WAIT_S)
    connection.request("GET", path)
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer.status, answer.headers["Content-Security-Policy"], body


def test_a_run_from_the_page_leaves_all_that_eal_run_leaves(tmp_path: Path) -> None:
    runs, scenarios = tmp_path / "runs", tmp_path / "scenarios"
    scenarios.mkdir()
    (scenarios / "turn.yaml").write_text(TURN)
    with (
        Fleet.load(SIM).connect() as fleet,
        open_dashboard(fleet, scenarios=scenarios, runs_dir=runs) as dashboard,
        page_of(dashboard) as page,
    ):
        for number in (1, 2):
            assert page.ask(do="start", file="turn.yaml")["ok"] is True
            page.hear_until(lambda: page.run.get("run") == number and "report" in page.run)  # noqa: B023
        status, policy, body = get(dashboard, page.run["report"])
        assert (status, policy.endswith("; sandbox allow-scripts")) == (200, True)
        assert "<title>turn on sim: done</title>" in body
        assert get(dashboard, "/runs/../secret/report.html")[0] == 404
        assert get(dashboard, "/runs/elsewhere/report.html")[0] == 404
    first, second = sorted(folder for folder in runs.iterdir() if folder.is_dir())
    for folder in (first, second):
        assert {file.name for file in folder.iterdir()} == KEPT
        run = RunFolder.open(folder)
        assert run.summary is not None
        assert run.summary.outcome == "done"
        assert abs(run.paths["roomba-1"][-1].yaw_rad - run.paths["roomba-1"][0].yaw_rad) > 0.2


def test_the_number_of_calls_stays_the_same_from_the_start_to_the_end(tmp_path: Path) -> None:
    scenarios = tmp_path / "scenarios"
    scenarios.mkdir()
    end = "finally: [{on: all, do: [{send_cmd: {resource: Base, cmd: turn0}}, {get_value: {resource: Pose}}]}]\n"
    (scenarios / "turn.yaml").write_text(scenario_of("send_cmd: {resource: Base, cmd: turn9}", role="all") + end)
    with (
        counting_fleet(tmp_path, "one", "two").connect() as fleet,
        open_dashboard(fleet, scenarios=scenarios) as dashboard,
        page_of(dashboard) as page,
    ):
        assert page.ask(do="start", file="turn.yaml")["ok"] is True
        totals = set()

        def is_over() -> bool:
            totals.add(page.run.get("calls"))
            return page.run.get("phase") == "ended"

        page.hear_until(is_over)
        assert page.run["done"] == 6
        assert totals - {None} == {6}


def test_a_run_that_the_end_of_the_dashboard_aborts_is_recorded_too(tmp_path: Path) -> None:
    runs, scenarios = tmp_path / "runs", tmp_path / "scenarios"
    scenarios.mkdir()
    (scenarios / "hold.yaml").write_text(TURN.replace("r20", "hold").replace("name: turn", "name: hold"))
    with (
        counting_fleet(tmp_path, "one").connect() as fleet,
        open_dashboard(fleet, scenarios=scenarios, runs_dir=runs) as dashboard,
        page_of(dashboard) as page,
    ):
        assert page.ask(do="start", file="hold.yaml")["ok"] is True
        page.hear_until(lambda: bool(page.robots.get("one", {}).get("running")))
        assert page.robots["one"]["control"] == {"": "scenario hold"}
    (folder,) = (each for each in runs.iterdir() if each.is_dir())
    assert "hold on counted: aborted" in (folder / "report.html").read_text(encoding="utf-8")
    summary = RunFolder.open(folder).summary
    assert summary is not None
    assert summary.outcome == "aborted"
