"""The report page of a run."""

from __future__ import annotations

import json
import os
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from eal_actors.recording import RunFolder, kept_world, render_report
from eal_actors.recording.timeline import Bar, timeline_of


class _Page(HTMLParser):
    """Collects the texts and the addresses of a page, and checks that its elements are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href") and value]
        if tag not in ("meta", "img", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="module")
def page(run: Path) -> _Page:
    return _Page(render_report(RunFolder.open(run), kept_world(run)))


def test_the_page_is_self_contained(page: _Page) -> None:
    assert not page.open
    assert page.links
    assert all(link.startswith(("data:", "#")) for link in page.links)


def test_the_page_names_outcome_robots_and_seed(page: _Page) -> None:
    text = " ".join(page.texts)
    assert "done" in text
    assert {"roomba-1", "evbot3-1"} <= set(page.texts)
    assert "off we go" in text


def test_what_the_page_counts_are_steps_since_a_wait_is_no_call(page: _Page, run: Path) -> None:
    ended = [event["record"] for event in RunFolder.open(run).events if event["event"] == "step_ended"]
    row = page.texts.index("roomba-1", page.texts.index("distance [m]"))
    numbers = [text for text in page.texts[row:] if text.isdecimal()]
    assert numbers[0] == str(sum(record["robot"] == "roomba-1" for record in ended))
    assert "Durations of steps" in page.texts


def test_the_page_shows_the_saved_images(page: _Page) -> None:
    assert sum(link.startswith("data:image/png") for link in page.links) >= 2
    assert "roomba-1/frame.png" in page.texts


def test_text_of_the_run_is_never_taken_for_html(run: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(run, tmp_path / "copy"))
    lines = (copy / "events.jsonl").read_text().splitlines()
    evil = {"event": "log", "time_s": 0.5, "robot": None, "text": "<script>alert(1)</script>"}
    (copy / "events.jsonl").write_text("\n".join([lines[0], json.dumps(evil), *lines[1:]]) + "\n")
    text = render_report(RunFolder.open(copy))
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)" in text


def test_a_run_whose_controller_crashed_has_a_page_too(run: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(run, tmp_path / "copy"))
    (copy / "summary.json").unlink()
    text = (copy / "events.jsonl").read_text().splitlines()
    (copy / "events.jsonl").write_text("\n".join(text[:5]) + "\n")
    page = render_report(RunFolder.open(copy))
    assert "the record is incomplete" in page
    assert re.search(r'class="bar unfinished"', page)


def test_parallel_calls_take_two_rows() -> None:
    line = timeline_of([])
    one, other, later = (Bar(a, b, "x", "s", "done", "") for a, b in ((0.0, 2.0), (1.0, 3.0), (2.0, 4.0)))
    line.bars["r"] = [one, other, later]
    assert line.rows("r") == [[one, later], [other]]


def test_links_and_pipes_in_a_folder_of_a_stranger_are_no_pictures(run: Path, tmp_path: Path) -> None:
    """A link led to any file of the reader, whose content came into the page, or to /dev/zero; a pipe never ended."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (tmp_path / "key.png").write_bytes(b"\x89PNG a private key")
    (folder / "a.png").symlink_to(tmp_path / "key.png")
    (folder / "b.png").symlink_to("/dev/zero")
    (folder / "c.png").symlink_to("nowhere")
    (folder / "d.png").mkdir()
    os.mkfifo(folder / "e.png")
    (folder / "scenario.yaml").unlink()
    os.mkfifo(folder / "scenario.yaml")
    page = _Page(render_report(RunFolder.open(folder)))
    assert not {f"{letter}.png" for letter in "abcde"} & set(page.texts)
