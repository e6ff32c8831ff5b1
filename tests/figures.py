"""Figures of pictures that a test draws, to read their labels and points."""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING

import pytest

from eal_actors.recording.arena import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def keep_figures(monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> list[Figure]:
    """Return the list to which every figure that a module draws is added."""
    figures: list[Figure] = []

    def kept(width: float, height: float) -> Figure:
        figure = new_figure(width, height)
        assert figure is not None
        figures.append(figure)
        return figure

    monkeypatch.setattr(module, "new_figure", kept)
    return figures
