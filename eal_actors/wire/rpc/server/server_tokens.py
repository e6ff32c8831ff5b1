"""ServerTokens: the liveliness tokens of a served robot, and the check that only one process serves it.

Where a process listens itself, its port refuses a second one. Behind a router, each declares a token of its own, then
looks for those of others: so of two that start together, each sees the other's. The token of a process that was cut
off stays until its link's lease has passed, so one that meets another one's token waits that long before it gives up.
The one with the smallest identifier waits twice as long: of those that start together it remains when the others have
given up, while one that serves the robot outlasts them all.

One that was frozen while another began serves the robot again afterwards. Both then log it, and warn controllers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from eal_actors.actors.robot_view import process_name
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.wire.format import keys
from eal_actors.wire.rpc.server.outbox import Outbox

if TYPE_CHECKING:
    import zenoh

_LOOK_S: Final = 0.1
_LOOKS: Final = 3
"""Looks in a row that must find no other: on a busy machine, some of the engine's answers lack some tokens, or all."""
_ANSWER_S: Final = 1.0
"""Real seconds to wait for an answer of the router."""
_LATE_S: Final = 1.0
"""Real seconds beyond a lease until its end is known here."""
_MAX_NAME: Final = 100


class ServerTokens:
    """The tokens of one robot, which a process serves, on its outbox's session; `lease_s` is that of its links.

    Thread: one at a time; each method blocks for a moment.
    """

    def __init__(self, outbox: Outbox, fleet: str, robot: str, process: str, lease_s: float) -> None:
        self._outbox = outbox
        self._fleet = fleet
        self._robot = robot
        self._process = process
        self._lease_s = lease_s
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._seen: dict[str, str] = {}

    def claim(self) -> None:
        """Become the only process that serves the robot; call `announce` next.

        Raises UnavailableError, with the names of the others, if others serve it for longer than a lease, or two
        for the smallest identifier. Thread: blocks the caller for that long if there is another, or no router answers.
        """
        if not self._outbox.transport.is_relayed:
            return
        self._declare(keys.server_key(self._fleet, self._robot, self._process, process_name()[:_MAX_NAME]))
        begin_s, patience_s = REAL_TIME.now(), self._lease_s + _LATE_S
        alone, is_met = 0, False
        while True:
            servers, waited_s = self._servers(), REAL_TIME.now() - begin_s
            others = {process: name for process, name in servers.items() if process != self._process}
            is_met = is_met or bool(others)
            alone = alone + 1 if servers and not others else 0
            if alone == _LOOKS or (not others and waited_s > (3 if is_met else 1) * patience_s):
                return
            if others and waited_s > (2 * patience_s if self._process < min(others) else patience_s):
                self.withdraw()
                error = UnavailableError(
                    f"is served already, by {' and '.join(sorted(others.values()))}", robot=self._robot
                )
                error.add_note("End that process first, or serve this robot under a name of its own.")
                raise error
            REAL_TIME.sleep(_LOOK_S)

    def announce(self) -> None:
        """Declare the robot's token, by which controllers find it."""
        self._declare(keys.alive_key(self._fleet, self._robot))

    def renew(self) -> None:
        """Declare the same tokens on the session that has replaced a closed one."""
        declared, self._tokens = self._tokens, {}
        for key in declared:
            self._declare(key)

    def note(self, process: str, name: str, *, is_alive: bool) -> None:
        """Keep that another process begins or ends to serve the robot. Thread: any; does not block."""
        if not is_alive:
            self._seen.pop(process, None)
        elif process != self._process:
            self._seen[process] = name
            get_logger(robot=self._robot).error("another process serves the robot too: end one of them", other=name)

    def forget(self) -> None:
        """Forget other processes: those that there are will be noted again. Thread: any; does not block."""
        self._seen.clear()

    def warnings(self) -> list[str]:
        """Return a warning if other processes serve the robot too. Thread: any; does not block."""
        names = sorted(self._seen.values())
        return [f"{' and '.join(names)} serves the robot too: end one of the processes"] if names else []

    def withdraw(self) -> None:
        """Undeclare the tokens, unless the session is closed."""
        tokens, self._tokens = self._tokens, {}
        if not self._outbox.transport.session.is_closed():
            for token in reversed(tokens.values()):
                token.undeclare()  # type: ignore[no-untyped-call]  # untyped in zenoh's stubs

    def _declare(self, key: str) -> None:
        self._tokens[key] = self._outbox.transport.session.liveliness().declare_token(key)

    def _servers(self) -> dict[str, str]:
        """Return the names of the processes that serve the robot, or begin to, by their identifiers.

        This one is among them, unless no router answers: there is none, or one of an older release with access control.
        """
        wanted = keys.server_key(self._fleet, self._robot, None, None)
        replies = self._outbox.transport.session.liveliness().get(wanted, timeout=_ANSWER_S)
        found = [keys.parse_server(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]
        return {process: name for _, process, name in found}
