"""The views of the page in a real Chromium."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from playwright.sync_api import Page, expect

from tests.operate.dashboard.rig import wait_for

OpenPage = Callable[..., AbstractContextManager[Page]]
VIEWS = ("mission", "fleet", "map", "cameras", "scenario", "logs", "robot/one")

expect.set_options(timeout=20_000)


def go(page: Page, view: str) -> None:
    page.evaluate("(view) => { location.hash = `#/${view}`; }", view)


def wait_until_halted(base: Any) -> None:
    wait_for(base, lambda: base.halts > 0)


def connected(page: Page) -> None:
    expect(page.locator("#connection")).to_contain_text("connected")
