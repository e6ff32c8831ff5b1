"""The site is built from pages, docstrings and schemas, with no warning, and loads nothing from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

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
