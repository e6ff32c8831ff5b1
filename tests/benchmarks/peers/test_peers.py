"""The benchmark beside others measures what it says, leaves out who is absent, and writes a page that tells it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.peers.engine import Publications, Pykka, Zenoh
from tests.benchmarks.peers.ours import Ours
from tests.benchmarks.peers.page import WHAT, Figure, draw, page
from tests.benchmarks.peers.peer import Absent, Peer
from tests.benchmarks.peers.tcp import Tcp


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Tcp, Zenoh, Publications, Pykka, Ours])
def test_every_measure_gives_seconds(kind: type[Peer]) -> None:
    peer = kind()
    try:
        for what in peer.measures:
            assert 0 < getattr(peer, what)(1) < 60, what
    finally:
        peer.close()


def test_who_is_not_installed_is_left_out_with_the_reason() -> None:
    class Missing(Tcp):
        modules = ("no_such_module_anywhere",)

    with pytest.raises(Absent, match=r"No module named 'no_such_module_anywhere'; `pip install --group peers`"):
        Missing()


def test_the_page_has_a_row_for_each_measure_and_says_who_is_absent(tmp_path: Path) -> None:
    figures = {
        "raw TCP": dict.fromkeys(WHAT, Figure(20e-6, 1.0)),
        "eal-actors": dict.fromkeys(WHAT, Figure(0.0123, 17.3)),
        "bare Pykka": {"get": Figure(1.5, 0.8)},
    }
    text = page(figures, ["eal-actors 1"], {"Pyro5": "it is not here"}, 15)
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(WHAT)
    assert lines[2] == "| reading of 24 bytes, p50 | 20.0 µs (1.0x) | 12.3 ms (17x) | 1.5 s (0.8x) |"
    assert lines[3].endswith("|  |")
    assert "Left out: Pyro5, for it is not here." in text
    draw(figures, tmp_path / "peers.svg")
    assert "eal-actors" in (tmp_path / "peers.svg").read_text(encoding="utf-8")
