"""`evbotos flash` shows the disk's content, asks for confirmation, and writes the image."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from evbotos.errors import FlashError
from evbotos.flash_command import flash
from tests.evbotos.flash.rig import a_file, make_image


def test_the_command_writes_what_it_was_told_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = make_image(tmp_path / "disk.img")
    card = a_file(tmp_path / "card", image.size)
    flash(image.path, card.path, yes=True, not_removable=True)
    said = capsys.readouterr()
    assert card.path.read_bytes() == image.path.read_bytes()
    assert f"{image.size} bytes written" in said.out
    assert "It seems to be empty" in said.err
    assert "checking 100 %" in said.err


def test_the_command_asks_before_it_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = make_image(tmp_path / "disk.img")
    card = a_file(tmp_path / "card", image.size)
    with Path(os.devnull).open() as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        with pytest.raises(FlashError, match="--yes"):
            flash(image.path, card.path, not_removable=True)
    with pytest.raises(FlashError, match="not a removable medium"):
        flash(image.path, card.path, yes=True)
    assert card.path.read_bytes() == bytes(image.size)
