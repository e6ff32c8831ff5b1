"""Sheets of paper with black rectangles to scale, as SVG and PDF.

Both formats are written directly: a sheet has rectangles and short texts only, and a library could change their scale.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from types import MappingProxyType
from typing import Final, Literal, TypeAlias

PaperName: TypeAlias = Literal["a4", "a3", "letter"]

PAPERS_MM: Final = MappingProxyType[PaperName, tuple[float, float]](
    {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
)
_POINTS_PER_MM: Final = 72 / 25.4
_TEXT_MM: Final = 3.5


@dataclass(frozen=True)
class Rectangle:
    """A black rectangle, from the sheet's top left corner, in millimetres."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float


@dataclass(frozen=True)
class Label:
    """A short text; its place is its left end on the base line, in millimetres."""

    x_mm: float
    y_mm: float
    text: str


@dataclass
class Sheet:
    """A sheet of paper, width and height in millimetres."""

    width_mm: float
    height_mm: float
    rectangles: list[Rectangle] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)

    def add_ruler(self) -> None:
        """Add a line of 100 mm at the foot, to check the printer's scale."""
        y_mm = self.height_mm - 7.0
        self.rectangles.append(Rectangle(10.0, y_mm, 100.0, 0.3))
        self.rectangles += [Rectangle(10.0 + end_mm, y_mm - 2.0, 0.3, 4.0) for end_mm in (-0.15, 99.85)]
        self.labels.append(Label(113.0, y_mm + 1.0, "100 mm: print at 100 %, without fitting to the page"))


def as_svg(sheet: Sheet) -> str:
    """Return a sheet as an SVG document in millimetres."""
    size = f'width="{sheet.width_mm:g}mm" height="{sheet.height_mm:g}mm"'
    box = f'viewBox="0 0 {sheet.width_mm:g} {sheet.height_mm:g}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {box}>',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    lines.append('<g fill="black" shape-rendering="crispEdges">')
    lines += [
        f'<rect x="{one.x_mm:.4f}" y="{one.y_mm:.4f}" width="{one.width_mm:.4f}" height="{one.height_mm:.4f}"/>'
        for one in sheet.rectangles
    ]
    lines.append(f'</g>\n<g font-family="Helvetica, Arial, sans-serif" font-size="{_TEXT_MM}">')
    lines += [f'<text x="{one.x_mm:.2f}" y="{one.y_mm:.2f}">{escape(one.text)}</text>' for one in sheet.labels]
    return "\n".join([*lines, "</g>\n</svg>\n"])


def as_pdf(sheets: Sequence[Sheet]) -> bytes:
    """Return a PDF document with a page for each sheet."""
    font, kids = 3, []
    objects: dict[int, bytes] = {font: b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"}
    for number, sheet in enumerate(sheets):
        page, content = 4 + 2 * number, 5 + 2 * number
        kids.append(f"{page} 0 R")
        width, height = sheet.width_mm * _POINTS_PER_MM, sheet.height_mm * _POINTS_PER_MM
        resources = f"/Resources << /Font << /F1 {font} 0 R >> >>"
        box = f"/MediaBox [0 0 {width:.4f} {height:.4f}]"
        objects[page] = f"<< /Type /Page /Parent 2 0 R {box} {resources} /Contents {content} 0 R >>".encode()
        stream = zlib.compress(_content(sheet).encode("latin-1", "replace"))
        head = f"<< /Length {len(stream)} /Filter /FlateDecode >>\nstream\n".encode()
        objects[content] = head + stream + b"\nendstream"
    objects[1] = b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>"
    objects[2] = f"<< /Type /Pages /Kids [{' '.join(kids)}] /Count {len(sheets)} >>".encode()
    return _document(objects)


def _content(sheet: Sheet) -> str:
    """Return a page's drawing commands; the scale makes a unit a millimetre, with y upwards."""
    lines = [f"{_POINTS_PER_MM:.8f} 0 0 {_POINTS_PER_MM:.8f} 0 0 cm", "0 g"]
    for one in sheet.rectangles:
        bottom_mm = sheet.height_mm - one.y_mm - one.height_mm
        lines.append(f"{one.x_mm:.4f} {bottom_mm:.4f} {one.width_mm:.4f} {one.height_mm:.4f} re")
    lines.append("f")
    for label in sheet.labels:
        text = label.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        place = f"{label.x_mm:.2f} {sheet.height_mm - label.y_mm:.2f} Td"
        lines.append(f"BT /F1 {_TEXT_MM} Tf {place} ({text}) Tj ET")
    return "\n".join(lines)


def _document(objects: dict[int, bytes]) -> bytes:
    """Return a PDF file with its table of the objects' places."""
    parts, places, length = [b"%PDF-1.4\n"], {}, len(b"%PDF-1.4\n")
    for number in sorted(objects):
        places[number] = length
        parts.append(f"{number} 0 obj\n".encode() + objects[number] + b"\nendobj\n")
        length += len(parts[-1])
    rows = "".join(f"{places[number]:010d} 00000 n \n" for number in sorted(objects))
    size = len(objects) + 1
    trailer = f"trailer\n<< /Size {size} /Root 1 0 R >>\nstartxref\n{length}\n%%EOF\n"
    parts.append(f"xref\n0 {size}\n0000000000 65535 f \n{rows}{trailer}".encode())
    return b"".join(parts)
