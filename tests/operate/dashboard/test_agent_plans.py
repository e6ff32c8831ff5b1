"""Plans of agents on the dashboard: a person sees all of a plan, and decides about its hash."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from eal_actors.operate.agents import PlanStore
from eal_actors.operate.audit import read_audit
from eal_actors.operate.dashboard import Access, Dashboard
from tests.operate.agents.waiting_plan import keep_plan

OpenPage = Callable[..., AbstractContextManager[Page]]
pytestmark = pytest.mark.timeout(180)
expect.set_options(timeout=20_000)


def test_a_person_reads_and_approves_a_plan(open_page: OpenPage, dashboard: Dashboard, tmp_path: Path) -> None:
    runs_dir = tmp_path / "runs"
    plan = keep_plan(runs_dir, "hall")
    with open_page(dashboard.link + "#/scenario", viewport={"width": 1100, "height": 900}) as page:
        panel = page.get_by_role("region", name="Plans of agents")
        expect(panel).to_contain_text("send_cmd: {resource: Base")
        expect(panel).to_contain_text("\\u202ederevorppa\\u202c <img src=x")  # shown as text, and visible
        assert page.locator("#main img").count() == 0
        if picture := os.environ.get("EAL_PICTURE"):
            Path(picture).write_bytes(page.screenshot())
        panel.get_by_role("button", name=f"Approve {plan.hash[:6]}").click()
        expect(panel).to_be_hidden()
    decision = PlanStore(runs_dir).decision(plan)
    assert decision is not None
    assert decision.is_approved
    assert decision.who == "anybody, dashboard"
    dashboard.close()
    (entry,) = [entry for entry in read_audit(runs_dir) if entry["command"] == "decide"]
    assert (entry["arguments"]["hash"], entry["outcome"]) == (plan.hash, "ok")


@pytest.mark.usefixtures("fleet")
def test_who_may_only_watch_decides_nothing(dashboard: Dashboard, open_page: OpenPage, tmp_path: Path) -> None:
    plan = keep_plan(tmp_path / "runs", "hall")
    dashboard.app_state.access.token = "secret"  # noqa: S105  # so this page may only watch
    assert not Access("127.0.0.1", "secret").is_open
    with open_page(dashboard.url + "#/scenario") as page:
        expect(page.locator("#connection")).to_contain_text("connected")
        answer = page.evaluate(
            "(decision) => import('/static/connection.js').then((module) => module.request('decide', decision))",
            {"hash": plan.hash, "approve": True},
        )
    assert answer["ok"] is False
    assert PlanStore(tmp_path / "runs").decision(plan) is None
