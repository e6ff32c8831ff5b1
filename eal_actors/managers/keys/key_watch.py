"""FileWatch and KeyWatch: notice when files or the keys of one end of the network have changed.

Only a complete change counts: the files are unchanged for one period, and the certificate fits its key.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from typing_extensions import override

from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.keys.certificates import check_keys, files_of
from eal_actors.managers.keys.revocation import REVOKED

WATCH_PERIOD_S: Final = 0.5
"""Real seconds between two looks at the files."""


class FileWatch:
    """Watches some files. Thread: one at a time."""

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = files
        self._used = self._seen = self._versions()

    def __bool__(self) -> bool:
        """Return whether there are files to watch."""
        return bool(self._files)

    def has_changed(self) -> bool:
        """Look at the files, once in each period; return whether they have changed since `accept`, completely."""
        versions = self._versions()
        is_stable, self._seen = versions == self._seen, versions
        return is_stable and versions != self._used

    def accept(self) -> None:
        """Count the files that `has_changed` has seen as used."""
        self._used = self._seen

    def _versions(self) -> list[int]:
        return [_version(file) for file in self._files]


class KeyWatch(FileWatch):
    """Watches the authority's certificate, a pair of keys and the revoked names, if there is a folder."""

    def __init__(self, folder: Path | None, name: str) -> None:
        self._folder, self._name = folder, name
        super().__init__(() if folder is None else (*files_of(folder, name), folder / REVOKED))

    @override
    def has_changed(self) -> bool:
        return super().has_changed() and self._fits()

    def _fits(self) -> bool:
        """Return whether the certificates and the key can be used, so that no link is closed in vain."""
        with contextlib.suppress(ConfigError):
            if self._folder is not None:
                check_keys(self._folder, self._name)
            return True
        return False


def _version(file: Path) -> int:
    """Return when a file changed, 0 for a missing one."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return 0
