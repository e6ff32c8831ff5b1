"""The site is built from pages, docstrings and schemas, with no warning, and loads nothing from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from eal_actors import __version__
from tests.chromium import launched_chromium

ROOT = Path(__file__).parents[2]
OUTSIDE = re.compile(r"""<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=["']?(?:https?:)?//[^>]*>""")

pytestmark = [pytest.mark.docs, pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site."""
    folder = tmp_path_factory.mktemp("site")
    strict = ("--fail-on-warning", "--keep-going", "--quiet")
    command = [sys.executable, "-m", "sphinx", *strict, "-c", "docs", "-d", f"{folder}/trees", ".", f"{folder}/site"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=800)
    assert done.returncode == 0, done.stderr
    return folder / "site"


def test_every_page_is_there(site: Path) -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        assert (site / page.relative_to(ROOT)).with_suffix(".html").is_file()
    assert 'url=docs/index.html"' in (site / "index.html").read_text()


def test_it_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 50
    for page in pages:
        assert not OUTSIDE.findall(page.read_text()), page
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(\s*[\"']?(?:https?:)?//|@import", style.read_text()), style


def test_every_link_leads_to_a_place_on_a_page(site: Path) -> None:
    """Sphinx has looked at links in our text already; this looks at all that it has made of them."""
    ids = {page: set(re.findall(r'\bid="([^"]+)"', page.read_text())) for page in site.rglob("*.html")}
    for page in ids:
        if "_modules" in page.parts:  # listings of the source; what is exported twice is linked back to one of both
            continue
        for target in re.findall(r'<a\b[^>]*\bhref="([^"]+)"', page.read_text()):
            if target.startswith(("http://", "https://", "mailto:")) or page.name == "index.html" == target:
                continue
            path, _, place = target.partition("#")
            led_to = (page.parent / path).resolve() if path else page.resolve()
            assert led_to.exists(), f"{page.relative_to(site)}: {target}"
            if place and led_to.suffix == ".html":
                assert place in ids[led_to] or not place.strip("#"), f"{page.relative_to(site)}: {target}"


def test_the_reference_tells_what_docstrings_and_schemas_tell(site: Path) -> None:
    def text_of(name: str) -> str:
        return re.sub(r"<[^>]+>", "", (site / f"docs/reference/{name}.html").read_text())

    assert "Return the id of a resource, valid in this connection only" in text_of("python")
    assert "AccessDeniedError" in text_of("errors")
    assert "Seconds of fleet time in one real second" in text_of("fleet-file")
    assert "eal keys controller" in text_of("eal")
    assert "--not-removable" in text_of("evbotos")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium."""
    with launched_chromium() as chromium:
        yield chromium


def test_search_finds_what_the_reader_calls_it(site: Path, browser: Browser) -> None:
    page = browser.new_page()
    for words, wanted in (
        ("joystick", "dashboard"),
        ("robot_not_found", "troubleshooting"),
        ("deadline", "troubleshooting"),
        ("emergency stop", "safety"),
    ):
        page.goto(f"file://{site}/search.html?q={words}")
        page.wait_for_selector("#search-results li")
        page.wait_for_function(
            "() => document.querySelector('#search-results p.search-summary').innerText.includes('finished')"
        )
        links = page.locator("#search-results li a").evaluate_all("links => links.map(link => link.href)")
        assert any(wanted in link for link in links), (words, links)


def test_blocks_have_copy_buttons_that_leave_prompts_out(site: Path, browser: Browser) -> None:
    page = browser.new_page()
    copy = 'window.copied = String(getSelection() || "") || document.activeElement.value'
    page.add_init_script(f"document.execCommand = () => {{ {copy}; return true }}")
    page.goto(f"file://{site}/docs/index.html")
    page.locator("button.copybtn").first.click(force=True)
    assert page.evaluate("window.copied").splitlines()[-1] == "eal run ballet --fleet formation --film --show"


def test_the_first_page_shows_how_to_begin_without_scrolling(site: Path, browser: Browser) -> None:
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.goto(f"file://{site}/docs/index.html")
    shown = {"pip install": page.get_by_text("pip install").first, "film": page.locator(".hero img")}
    for name, part in {**shown, "doors": page.locator(".doors")}.items():
        box = part.bounding_box()
        assert box is not None, name
        assert box["y"] + box["height"] <= 900, name


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 390])
def test_no_page_is_wider_than_the_window(site: Path, browser: Browser, width: int, scheme: str) -> None:
    page = browser.new_page(
        viewport={"width": width, "height": 844}, color_scheme="dark" if scheme == "dark" else "light"
    )
    for source in sorted((ROOT / "docs").rglob("*.md")):
        page.goto((site / source.relative_to(ROOT)).with_suffix(".html").as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= width, source
        assert f"EAL actors {__version__}" in page.title()
