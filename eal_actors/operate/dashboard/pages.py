"""The files of the page, and the HTTP headers of every answer."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final, NamedTuple

from eal_actors.recording.player import player_script

INDEX: Final = "index.html"
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}

SECURITY_HEADERS: Final[Mapping[str, str]] = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
    "Cache-Control": "no-cache",
}


def report_headers() -> Mapping[str, str]:
    """Return the headers of the report of a run: one page with its styles and pictures, which runs its player alone.

    It has no origin, so the player reaches neither the dashboard's page nor its websocket.
    """
    digest = base64.b64encode(hashlib.sha256(player_script().encode()).digest()).decode()
    return {
        "Content-Security-Policy": (
            f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'self'; sandbox allow-scripts"
        ),
        "X-Frame-Options": "SAMEORIGIN",
    }


class Page(NamedTuple):
    """A file and its media type."""

    content: bytes
    media_type: str


def read_pages() -> Mapping[str, Page]:
    """Return the files that browsers may request, by name. No other file is served."""
    return dict(_pages(files("eal_actors.operate.dashboard") / "static", ""))


def _pages(folder: Traversable, prefix: str) -> Iterator[tuple[str, Page]]:
    for file in folder.iterdir():
        suffix = file.name[file.name.rfind(".") :]
        if file.is_dir():
            yield from _pages(file, f"{prefix}{file.name}/")
        elif suffix in _TYPES:
            yield f"{prefix}{file.name}", Page(file.read_bytes(), _TYPES[suffix])
