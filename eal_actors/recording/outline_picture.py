"""Picture of a scenario's outline: a tree as an SVG document that needs no fonts and no network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import Final

from eal_actors.scenario.report.outline import OutlineLine

_ROW_PX: Final = 24
_INDENT_PX: Final = 22
_MARGIN_PX: Final = 12
_CHARACTER_PX: Final = 8.0
_COLOURS: Final = {"section": "#5f6b7a", "role": "#5f6b7a", "branch": "#a55a00", "on": "#0072b2", "expect": "#007a5a"}
_BLOCKS: Final = ("on", "parallel", "repeat", "for", "while", "if", "sequence", "scenario")
_INK: Final = "#1b1f24"
_LINE: Final = "#b8c0c8"


def draw_outline(lines: Sequence[OutlineLine]) -> str:
    """Return the tree as SVG; the number at the left is the line in the scenario's file."""
    rows = [_row(number, line) for number, line in enumerate(lines)]
    widest = max((_text_x(line) + len(line.text) * _CHARACTER_PX for line in lines), default=0.0)
    width, height = round(widest) + _MARGIN_PX, len(lines) * _ROW_PX + 2 * _MARGIN_PX
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'font-family="monospace" font-size="13"><rect width="{width}" height="{height}" fill="#ffffff"/>'
        f"{''.join(_links(lines))}{''.join(rows)}</svg>"
    )


def _row(number: int, line: OutlineLine) -> str:
    y = _middle_y(number) + 4
    colour = _COLOURS.get(line.kind, _INK)
    weight = "; font-weight: bold" if line.kind in (*_BLOCKS, "section") else ""
    text = escape(line.text, quote=False)
    return (
        f'<text x="{_MARGIN_PX + 28}" y="{y}" style="fill: {_LINE}; font: inherit" text-anchor="end">'
        f"{line.line or ''}</text>"
        f'<text x="{_text_x(line)}" y="{y}" style="fill: {colour}; font: inherit{weight}">{text}</text>'
    )


def _links(lines: Sequence[OutlineLine]) -> Iterator[str]:
    """Yield the lines from each row to the one that it lies below."""
    around: list[int] = []
    for number, line in enumerate(lines):
        while around and lines[around[-1]].depth >= line.depth:
            around.pop()
        if around:
            above = around[-1]
            x, y = _text_x(lines[above]) + 5, _middle_y(number)
            yield f'<path d="M{x} {_middle_y(above) + 8} V{y} H{_text_x(line) - 4}" fill="none" stroke="{_LINE}"/>'
        around.append(number)


def _text_x(line: OutlineLine) -> float:
    return _MARGIN_PX + 40 + line.depth * _INDENT_PX


def _middle_y(number: int) -> float:
    return _MARGIN_PX + (number + 0.5) * _ROW_PX
