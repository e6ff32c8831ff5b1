"""KeyWatch: notices when the keys of one end of the network have changed, so that no restart is needed.

Only a complete change counts: the files are unchanged for one period, and the certificate fits its key.
"""

from __future__ import annotations

import ssl
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from eal_actors.wire.security.certificates import AUTHORITY, certificate_file, key_file
from eal_actors.wire.security.revocation import REVOKED

WATCH_PERIOD_S: Final = 0.5
"""Real seconds between two looks at the files."""


class KeyWatch:
    """Watches the authority's certificate, a pair of keys and the revoked names, if there is a folder. Thread: one."""

    def __init__(self, folder: Path | None, name: str) -> None:
        self._files: tuple[Path, ...] = ()
        if folder is not None:
            self._pair = certificate_file(folder, name), key_file(folder, name)
            self._files = (certificate_file(folder, AUTHORITY), *self._pair, folder / REVOKED)
        self._used = self._seen = file_versions(self._files)

    def __bool__(self) -> bool:
        """Return whether there are keys to watch."""
        return bool(self._files)

    def has_changed(self) -> bool:
        """Look at the files, once in each period; return whether they have changed since `accept`, completely."""
        versions = file_versions(self._files)
        is_stable, self._seen = versions == self._seen, versions
        return is_stable and versions != self._used and self._fits()

    def accept(self) -> None:
        """Count the files that `has_changed` has seen as used."""
        self._used = self._seen

    def _fits(self) -> bool:
        """Return whether the certificate and its key can be used, so that no link is closed in vain."""
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(*self._pair)
        except (OSError, ssl.SSLError):
            return False
        return True


def file_versions(files: Iterable[Path]) -> tuple[int, ...]:
    """Return when each file changed, 0 for a missing one."""
    return tuple(map(_version, files))


def _version(file: Path) -> int:
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return 0
