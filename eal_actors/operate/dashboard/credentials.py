"""CredentialWatch: follows the certificate and the operators of a dashboard while it serves.

A renewed certificate counts for the next connections. Operators who are removed from the fleet file, or whose token or
role has changed, are disconnected at once; all others stay. A file with a mistake changes nothing.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Final

from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig, OperatorSection
from eal_actors.managers.keys.certificates import DASHBOARD, certificate_file, key_file, list_certificates
from eal_actors.managers.keys.key_watch import WATCH_PERIOD_S, FileWatch, KeyWatch
from eal_actors.operate.dashboard.access import Access
from eal_actors.operate.dashboard.sign_in import SignIn

_SECTION: Final = "dashboard"  # of the fleet file, with the operators


class CredentialWatch:
    """Follows a dashboard's files.

    Args:
        dismiss: ends the sessions of operators. Thread: the loop's.
        access: gets the host names of a new certificate.
        tls: gets a new certificate; None without HTTPS.
        keys: the folder of the certificate; None watches none.
    """

    def __init__(
        self,
        config: FleetConfig,
        sign_in: SignIn,
        dismiss: Callable[[Collection[str]], None],
        access: Access,
        tls: ssl.SSLContext | None,
        keys: Path | None,
    ) -> None:
        self._source = config.source
        self._sign_in = sign_in
        self._dismiss = dismiss
        self._access = access
        self._certificate = None if tls is None or keys is None else (tls, keys)
        self._keys = KeyWatch(None if tls is None else keys, DASHBOARD)
        self._files = FileWatch(_files_of(config) if access.asks_for_names else ())

    async def run(self) -> None:
        """Follow the files until it is cancelled. Thread: the loop's; the fleet file is read in another one."""
        while True:
            await asyncio.sleep(WATCH_PERIOD_S)
            if self._certificate is not None and self._keys.has_changed():
                self._keys.accept()
                self._use_certificate(*self._certificate)  # here, since no handshake may see half of it
            if self._files.has_changed():
                self._files.accept()
                if (operators := await asyncio.to_thread(self._read_operators)) is not None:
                    self._use_operators(operators)

    def _use_certificate(self, tls: ssl.SSLContext, folder: Path) -> None:
        try:
            hosts = [found.hosts for found in list_certificates(folder) if found.name == DASHBOARD]
            tls.load_cert_chain(certificate_file(folder, DASHBOARD), key_file(folder, DASHBOARD))
        except (OSError, EALError) as error:
            reason = error_text(error)
            get_logger().error("the changed certificate cannot be used; the former one stays in use", reason=reason)
            return
        self._access.names = hosts[0]
        get_logger().info("the dashboard's certificate has changed")

    def _read_operators(self) -> Mapping[str, OperatorSection] | None:
        """Return the operators of the fleet file; None if it is wrong."""
        try:
            config = EALConfigManager.load(self._source).fleet
        except EALError as error:
            get_logger().error("the operators were not read again: the fleet file is wrong", reason=error.message)
            return None
        self._files = FileWatch(_files_of(config))
        return config.operators

    def _use_operators(self, operators: Mapping[str, OperatorSection]) -> None:
        former = self._access.operators
        changed = [name for name, operator in former.items() if operators.get(name) != operator]
        if operators == former:
            return
        self._sign_in.replace_operators(operators)
        self._dismiss(changed)
        added = sorted(operators.keys() - former.keys())
        get_logger().info("the dashboard's operators have changed", signed_out=changed, added=added)


def _files_of(config: FleetConfig) -> tuple[Path, ...]:
    """Return the fleet file and those of its includes that name operators."""
    root = config.tree.root
    marks = [root.key_marks[_SECTION]] if _SECTION in root else []
    for section in (root.get(_SECTION), root.get(_SECTION, {}).get("operators", {})):
        marks += getattr(section, "key_marks", {}).values()
    return tuple({config.source: None, **dict.fromkeys(Path(mark.file) for mark in marks)})
