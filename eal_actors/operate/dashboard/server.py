"""Dashboard: puts the fleet's side, the hub and the web server together."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard.access import Access
from eal_actors.operate.dashboard.app import App
from eal_actors.operate.dashboard.arena import arena_of
from eal_actors.operate.dashboard.bell import Bell
from eal_actors.operate.dashboard.browser import Backstage
from eal_actors.operate.dashboard.cameras import Cameras
from eal_actors.operate.dashboard.commander import Commander
from eal_actors.operate.dashboard.control import Control
from eal_actors.operate.dashboard.doings import Doings
from eal_actors.operate.dashboard.hub import Hub
from eal_actors.operate.dashboard.limits import MAX_CAMERAS, MAX_FRAMES_PER_S
from eal_actors.operate.dashboard.log_tap import LogTap
from eal_actors.operate.dashboard.runs import Runs
from eal_actors.operate.dashboard.steering import SILENCE_S, Steering
from eal_actors.operate.dashboard.watcher import Watcher
from eal_actors.operate.dashboard.web_server import WebServer, listen_at

DEFAULT_PORT: Final = 8080
_ANYWHERE: Final = ("0.0.0.0", "::")  # noqa: S104  # compared with, not listened at


class Dashboard:
    """The dashboard of one fleet, between `with` and its end.

    When it ends, a run that it started is aborted, what is steered by hand is halted, and no thread is left. The fleet
    stays connected.

    Args:
        fleet: a connected fleet, whose clock runs as time does: with `rate: max` there is nothing to watch.
        access: where it listens, and who may command.
        port: 0 for any that is free.
        scenarios: the folder of scenarios that can be started; None for none.
        runs_dir: where the folders of runs are made; None keeps no records, and scenarios that save files do not start.

    Raises:
        ConfigError: it cannot listen there.
    """

    def __init__(
        self,
        fleet: Fleet,
        access: Access | None = None,
        *,
        port: int = 0,
        scenarios: Path | None = None,
        runs_dir: Path | None = None,
    ) -> None:
        self.access: Final = access if access is not None else Access("127.0.0.1")
        self._fleet = fleet
        self._listener = listen_at(self.access.host, port)
        self.port: Final[int] = self._listener.getsockname()[1]
        bell = Bell()
        self.hub: Final = Hub(bell.ring)
        doings, control = Doings(), Control()
        self._log_tap = LogTap(self.hub, doings)
        self._cameras = Cameras(fleet, bell.ring)
        self._steering = Steering(fleet, control)
        self._runs = Runs(fleet, self.hub, doings, control, scenarios, runs_dir)
        commander = Commander(fleet, doings, control, self._runs, self._steering, self._cameras)
        self.backstage: Final = Backstage(
            self.hub, bell, self.access, commander, self._cameras, fleet.clock, self._introduction, self._runs.report
        )
        self.app: Final = App(self.backstage)
        self._watcher = Watcher(fleet, self.hub, doings, control, lambda: bool(self.app.browsers))
        self._web_server = WebServer(self.app.asgi, self._listener, bell)
        self._stack = ExitStack()

    def _introduction(self) -> dict[str, Any]:
        config = self._fleet.config
        return {
            "fleet": config.name,
            "robots": list(self._fleet),
            "arena": arena_of(config.world),
            "trails": self._watcher.trails(),
            "rate": self._fleet.clock.of_real(1.0),
            "silence_s": SILENCE_S,
            "max_cameras": MAX_CAMERAS,
            "max_frames_per_s": MAX_FRAMES_PER_S,
        }

    @property
    def url(self) -> str:
        """Where to look, without a token."""
        host = "127.0.0.1" if self.access.host in _ANYWHERE else self.access.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"

    @property
    def link(self) -> str:
        """Where to look, with the token if there is one: behind the `#` it is never sent to a server or its logs."""
        return self.url if self.access.token is None else f"{self.url}#token={self.access.token}"

    def start(self) -> Self:
        """Begin to serve.

        Raises:
            UnavailableError: the web server did not start.

        Thread: blocks the caller until it serves.
        """
        with ExitStack() as stack:
            stack.enter_context(self._log_tap)
            stack.callback(self._cameras.close)
            self._watcher.start()
            stack.callback(self._watcher.close)
            self._web_server.start()
            stack.callback(self._web_server.close)
            stack.callback(self._runs.close)
            self._steering.start()
            stack.callback(self._steering.close)
            self._stack = stack.pop_all()
        return self

    def close(self) -> None:
        """Halt what is steered, abort the run, and end; harmless the second time. Thread: blocks the caller."""
        self._stack.close()
        self._listener.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
