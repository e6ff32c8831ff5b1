"""A fleet of counting robots, and a real Chromium where one is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard import Dashboard
from tests.chromium import launched_chromium
from tests.cli.conftest import eal as eal
from tests.operate.dashboard.rig import counting_fleet, open_dashboard


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    """Yield a connected fleet of two counting robots."""
    with counting_fleet(tmp_path, "one", "two").connect() as opened:
        yield opened


@pytest.fixture
def dashboard(fleet: Fleet, tmp_path: Path) -> Iterator[Dashboard]:
    """Yield the dashboard of that fleet."""
    with open_dashboard(fleet, runs_dir=tmp_path / "runs") as opened:
        yield opened


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """The browser, for one module: its driver runs an event loop in the main thread, which disturbs other tests."""
    with launched_chromium() as browser:
        yield browser


@pytest.fixture
def open_page(chromium: Browser) -> Iterator[Callable[..., Any]]:
    """Opens pages by their links; errors on their console fail the test."""
    errors: list[str] = []

    @contextmanager
    def opened(link: str, *, expects_errors: bool = False, **options: Any) -> Iterator[Page]:
        context = chromium.new_context(**options)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        if not expects_errors:  # of connections that fail
            page.on("console", lambda line: errors.append(line.text) if line.type == "error" else None)
        page.goto(link)
        try:
            yield page
        finally:
            context.close()

    yield opened
    assert not errors
