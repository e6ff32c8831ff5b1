"""SessionKeeper: keeps a session open, and opens it again when its keys change or its engine is out of order.

zenoh reads certificates and access control when a session opens. A renewed certificate or a longer list of revoked ones
takes effect by a new session: its predecessor's links end, and all controllers whose certificates still count connect
again. An engine that finishes no handshake any more (link_watch) is replaced in the same way, so that no restart of the
process is needed. Meanwhile no heartbeat arrives, and the dead-man's switch halts what controllers move.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.expiry import certificate_warnings
from eal_actors.managers.keys.key_watch import WATCH_PERIOD_S, KeyWatch
from eal_actors.managers.keys.revocation import revoke
from eal_actors.managers.network_model import DEFAULT_NETWORK, NetworkConfig
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import decode_call
from eal_actors.wire.session import open_session
from eal_actors.wire.transport import Transport

if TYPE_CHECKING:
    import zenoh

_JOIN_S: Final = 3.0


class SessionKeeper(EALActor):
    """Owns the session of a robot or a router, whose certificate has its name; without security no keys are watched.

    Thread: an actor, which blocks while it opens a session.
    """

    def __init__(self, name: str, network: NetworkConfig, configure: Callable[[], dict[str, Any]]) -> None:
        super().__init__(f"{name} session", REAL_TIME)
        self._configure = configure
        self._warnings = partial(certificate_warnings, network.security, name)
        self._keys = KeyWatch(None if network.security is None else network.security.keys, name)
        self._on_session: Callable[[zenoh.Session], None] = lambda _: None
        self._stack = ExitStack()
        self._is_stuck = False

    def open(self) -> zenoh.Session:
        """Open a session; see open_session. Thread: blocks the caller."""
        for warning in self._warnings():
            get_logger(actor=self.name).warning(warning)
        return self._stack.enter_context(open_session(self._configure(), on_stuck=self._replace_soon))

    def follow(self, on_session: Callable[[zenoh.Session], None]) -> None:
        """Watch the keys and the engine from now on.

        `on_session` is called with each later session, after its predecessor was closed. Thread: the keeper's.
        """
        self._on_session = on_session
        self.launch()

    def close(self) -> None:
        """Close the session. Thread: blocks the caller, for a bounded time."""
        if self.thread is None:
            self._stack.close()
            return
        self.end_soon()
        self.thread.join(_JOIN_S)

    def _replace_soon(self) -> None:
        """Open the session again, with the next tick. Thread: any."""
        self._is_stuck = True

    @override
    def on_start(self) -> None:
        self._tick()

    @override
    def on_stop(self) -> None:
        self._stack.close()

    @override
    def on_crash(self, error: BaseException) -> None:
        get_logger().error("changed keys are no longer followed", actor=self.name, error=error_text(error))
        self._stack.close()

    def _tick(self) -> None:
        if self._keys.has_changed():
            self._reopen("the keys have changed")
        elif self._is_stuck:
            self._reopen("the network engine finishes no handshake")
        self.actor_inbox.call_later(WATCH_PERIOD_S, self._tick)

    def _reopen(self, why: str) -> None:
        import zenoh

        log = get_logger(actor=self.name)
        self._stack.close()
        try:
            self._on_session(self.open())
        except (EALError, zenoh.ZError) as error:  # tried again with the next tick
            log.error("the network cannot be opened again; it is tried again", why=why, reason=error_text(error))
            return
        self._is_stuck = False
        self._keys.accept()
        log.warning(f"{why}: the network was opened again")


@contextmanager
def router_session(fleet: FleetConfig | None, name: str, configure: Callable[[], dict[str, Any]]) -> Iterator[None]:
    """Keep a router's session open for the length of a `with` block, with a certificate of the given name.

    Without a fleet, it is the router of all fleets, without security. A router stores the revoked names that it
    forwards to robots, so that it follows them too. Raises UnavailableError if the port is in use, and ConfigError if
    the keys are missing. Thread: blocks the caller while it opens and closes.
    """
    keeper = SessionKeeper(name, DEFAULT_NETWORK if fleet is None else fleet.network, configure)
    security = None if fleet is None else fleet.network.security
    transports: list[Transport] = []  # of the open session

    def subscribe(session: zenoh.Session) -> None:
        if fleet is not None and security is not None:
            store = partial(_store_revoked, security.keys)
            transports[:] = [Transport(session)]
            transports[0].receive(keys.revoke_keys(fleet.network_name), f"{name} revoked names", store)

    try:
        subscribe(keeper.open())
        keeper.follow(subscribe)
        yield
    finally:
        keeper.close()


def _store_revoked(folder: Path, _: str, envelope: bytes, __: bytes) -> None:
    """Store the names of a call, which never has parts: robots refuse one with that many."""
    try:
        revoke(folder, map(str, decode_call(envelope)[0].arguments))
    except EALError as error:
        get_logger().error("revoked names were not stored", reason=error.message)
