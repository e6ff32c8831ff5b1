"""The layout and the accessibility of every view, in a real Chromium."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard import Dashboard
from tests.house import javascript
from tests.operate.dashboard.pages import VIEWS, OpenPage, connected, go

AXE = (
    """axe.run({ rules: { "label-content-name-mismatch": { enabled: true } } }).then(({ violations }) => violations)"""
)

pytestmark = pytest.mark.timeout(180)


@pytest.fixture(scope="module")
def axe() -> str:
    """The source of axe-core, which finds violations of the accessibility guidelines."""
    try:
        failed = javascript.install()
    except javascript.NotCheckedError as error:
        pytest.skip(str(error))
    assert failed is None, failed.stderr
    return (javascript.FOLDER / "node_modules/axe-core/axe.min.js").read_text(encoding="utf-8")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_violation_in_any_view(
    open_page: OpenPage, fleet: Fleet, dashboard: Dashboard, axe: str, scheme: str
) -> None:
    with open_page(dashboard.link, color_scheme=scheme) as page:
        connected(page)
        page.evaluate(axe)
        found = [line for view in VIEWS for line in violations(page, view)]
        page.keyboard.press("Escape")
        expect(page.locator("#stopped")).to_contain_text("All robots refuse to move")
        assert not found + violations(page, "fleet")


def violations(page: Page, view: str) -> list[str]:
    """Return what axe finds in a view, with all that can be unfolded."""
    go(page, view)
    expect(page.locator("main h1")).to_be_visible()
    if view.startswith("robot/"):
        expect(page.locator(".reading .number").first).to_be_visible()
        page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    return [
        f"{view}: {violation['id']}: {node['html'][:160]}: {node['failureSummary']}"
        for violation in page.evaluate(AXE)
        for node in violation["nodes"]
    ]


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("width", [375, 1280])
def test_nothing_is_wider_than_the_screen_and_everything_has_a_name(
    open_page: OpenPage, dashboard: Dashboard, view: str, width: int
) -> None:
    with open_page(dashboard.link + f"#/{view}", viewport={"width": width, "height": 720}) as page:
        connected(page)
        expect(page.locator("main h1")).to_be_visible()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        expect(page.get_by_role("button", name="STOP")).to_be_in_viewport()
        nameless = page.evaluate(
            """[...document.querySelectorAll('button, select, input, canvas')].filter((node) =>
                !(node.getAttribute('aria-label') || node.textContent.trim() || node.labels?.length)).length"""
        )
        assert nameless == 0
