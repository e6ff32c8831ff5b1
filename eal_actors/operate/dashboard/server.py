"""Dashboard: connects the parts of the dashboard, and starts and stops them."""

from __future__ import annotations

import ssl
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from typing import Any, Final, Self

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.throttled_log import ThrottledLog
from eal_actors.operate.audit import AuditLog
from eal_actors.operate.dashboard.access import Access
from eal_actors.operate.dashboard.app import App
from eal_actors.operate.dashboard.cameras import Cameras
from eal_actors.operate.dashboard.control import ControlRegistry, DashboardContext
from eal_actors.operate.dashboard.credentials import CredentialWatch
from eal_actors.operate.dashboard.dispatcher import Dispatcher
from eal_actors.operate.dashboard.fleet_poller import FleetPoller
from eal_actors.operate.dashboard.limits import MAX_CAMERAS, TokenBucket
from eal_actors.operate.dashboard.log_tap import LogTap
from eal_actors.operate.dashboard.notifier import Notifier
from eal_actors.operate.dashboard.run_manager import RunManager
from eal_actors.operate.dashboard.session import AppState
from eal_actors.operate.dashboard.sign_in import SignIn
from eal_actors.operate.dashboard.teleop import Teleop
from eal_actors.operate.dashboard.values import ValuePoller
from eal_actors.operate.dashboard.web_server import WebServer, listen_at
from eal_actors.operate.dashboard.world_map import world_map

DEFAULT_PORT: Final = 8080
_ANYWHERE: Final = ("0.0.0.0", "::")  # noqa: S104  # compared with, not listened at


class Dashboard:
    """The dashboard of one fleet, between `with` and its end.

    At its end the dashboard aborts its run, halts what is driven by hand, and leaves no thread. The fleet stays
    connected.

    Args:
        fleet: a connected fleet. Its clock must follow real time: with `rate: max` there is nothing to watch.
        log: the log lines so far, and those to come, until its own end; None for those from the dashboard's start.
        port: the port; 0 for any free port.
        scenarios: the folder of scenarios that the page can start; None for none.
        runs_dir: the parent of the runs' folders, and the folder of the audit log; None keeps neither, and scenarios
            that save files cannot start.
        tls: the certificate to serve HTTPS with, from `tls_context`; None serves HTTP.
        keys: the folder of that certificate, whose successor is used as soon as it is there; None watches none.

    Raises ConfigError if it cannot listen at that address, or the audit log cannot be written.
    """

    def __init__(
        self,
        fleet: Fleet,
        access: Access | None = None,
        *,
        log: LogTap | None = None,
        port: int = 0,
        scenarios: Path | None = None,
        runs_dir: Path | None = None,
        tls: ssl.SSLContext | None = None,
        keys: Path | None = None,
    ) -> None:
        self.access: Final = access if access is not None else Access("127.0.0.1")
        self._fleet = fleet
        self._tls = tls
        self._audit = AuditLog(runs_dir)
        self._listener = listen_at(self.access.host, port)
        self.port: Final[int] = self._listener.getsockname()[1]
        notifier = Notifier()
        self._log: AbstractContextManager[object] = nullcontext()
        if log is None:
            self._log = log = LogTap()
        self.store: Final = log.store
        self.store.on_change = notifier.notify
        context = DashboardContext(fleet, self.store, log.steps, ControlRegistry())
        self._cameras = Cameras(fleet, notifier.notify)
        self._teleop = Teleop(fleet, context.control)
        self._runs = RunManager(context, scenarios, runs_dir)
        values = ValuePoller(fleet, self.store)
        dispatcher = Dispatcher(context, self._runs, self._teleop, self._cameras, values)
        self.app_state: Final = AppState(
            self.store,
            notifier,
            self.access,
            sign_in := SignIn(self.access),
            self._audit,
            TokenBucket(per_s=1.0, at_once=20.0),
            ThrottledLog(),
            dispatcher,
            self._cameras,
            fleet.clock,
            self._introduction,
            self._runs.report,
        )
        self.app: Final = App(self.app_state)
        self._poller = FleetPoller(context, values, lambda: bool(self.app.browsers))
        credentials = CredentialWatch(fleet.config, sign_in, self.app.dismiss, self.access, tls, keys)
        self._web_server = WebServer(self.app.asgi, self._listener, notifier, tls, credentials.run)
        self._stack = ExitStack()

    def _introduction(self) -> dict[str, Any]:
        config = self._fleet.config
        return {
            "fleet": config.name,
            "robots": list(self._fleet),
            "world": world_map(config.world),
            "trails": self._poller.trails(),
            "rate": self._fleet.clock.of_real(1.0),
            "now_s": self._fleet.clock.now(),
            "max_cameras": MAX_CAMERAS,
        }

    @property
    def url(self) -> str:
        """The page's address, without a token."""
        host = "127.0.0.1" if self.access.host in _ANYWHERE else self.access.host
        return f"http{'s' if self._tls else ''}://{f'[{host}]' if ':' in host else host}:{self.port}/"

    @property
    def link(self) -> str:
        """The page's address with the token, if there is one. Behind the `#`, browsers send it to no server."""
        return self.url if self.access.token is None else f"{self.url}#token={self.access.token}"

    def start(self) -> Self:
        """Start to serve; UnavailableError if the web server did not start.

        Thread: blocks the caller until it serves.
        """
        with ExitStack() as stack:
            self._audit.start()
            stack.callback(self._audit.close)
            stack.enter_context(self._log)
            stack.callback(self._cameras.close)
            self._poller.start()
            stack.callback(self._poller.close)
            self._web_server.start()
            stack.callback(self._web_server.close)
            stack.callback(self._runs.close)
            self._teleop.start()
            stack.callback(self._teleop.close)
            self._stack = stack.pop_all()
        return self

    def close(self) -> None:
        """Halt what is driven by hand, abort the run, and end; idempotent. Thread: blocks the caller."""
        self._stack.close()
        self._audit.close()
        self._listener.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()
