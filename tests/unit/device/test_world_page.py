"""The examples of docs/worlds.md are valid, piece by piece; whole files are checked with those of other pages."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from eal_actors.device.world import WorldModel, load_world

PAGE = Path(__file__).parents[3].joinpath("docs", "worlds.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
PIECES = [block for block in BLOCKS if not block.startswith("version: 1\n")]


@pytest.mark.parametrize("piece", PIECES, ids=lambda piece: piece.partition(":")[0])
def test_every_piece_fits_into_a_room(tmp_path: Path, piece: str) -> None:
    file = tmp_path / "w.yaml"
    file.write_text(f"version: 1\nname: w\nsize_m: [8, 6]\n{piece}", encoding="utf-8")

    load_world(file)


def test_every_key_has_an_example() -> None:
    shown = {line.partition(":")[0] for block in BLOCKS for line in block.splitlines() if re.match(r"\w+:", line)}

    assert shown == set(WorldModel.model_fields)
