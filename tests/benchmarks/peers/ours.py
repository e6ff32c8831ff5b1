"""This project: a fleet whose robots are in another process, with leases, receipts, deadlines and heartbeats."""

from __future__ import annotations

import statistics
from typing import Any

from eal_actors import Fleet, gather
from tests.benchmarks.network_host import fleet_of
from tests.benchmarks.peers.peer import GIVE_UP_S, ROBOTS, Server, SyncPeer, timed
from tests.net.links import free_port


class _Handle:
    def __init__(self, robot: Any) -> None:
        self._lamp, self._eye = robot["Lamp"], robot["Eye"]

    def get(self) -> None:
        self._lamp.get_value().get()

    def command(self) -> None:
        self._lamp.send_cmd("on").get()

    def frame(self) -> None:
        self._eye.get_value().get()


class Ours(SyncPeer):
    """A robot for what one does, and a hundred in another process for the fan-out."""

    name = "eal-actors"
    package = "eal-actors"

    def __init__(self) -> None:
        self._crowd_port = free_port()
        self._crowd = self._host(ROBOTS, self._crowd_port)
        self._fleets: list[Fleet] = []
        super().__init__()

    def serve(self) -> Server:
        return self._host(1, self.port)

    @staticmethod
    def _host(robots: int, port: int) -> Server:
        return Server(["-m", "tests.benchmarks.network_host", str(robots), str(port)])

    def _fleet(self, robots: int, port: int) -> Fleet:
        fleet = Fleet(fleet_of(robots, port)).connect()
        self._fleets.append(fleet)
        return fleet

    def handle(self) -> _Handle:
        """All callers share one fleet."""
        if not self._fleets:
            self._fleet(1, self.port)
        return _Handle(self._fleets[0]["bot1"])

    def fan_out(self, count: int) -> float:
        if len(self._fleets) < 2:
            self._fleet(ROBOTS, self._crowd_port)
        lamps = [robot["Lamp"] for robot in self._fleets[1].values()]

        def once() -> None:
            gather([lamp.send_cmd("on") for lamp in lamps]).get()

        once()
        return statistics.median(timed(once) for _ in range(count))

    def try_once(self) -> None:
        """The fleet looks for its robots by itself."""
        self._fleets[0]["bot1"]["Lamp"].get_value(timeout_s=GIVE_UP_S).get()

    def close(self) -> None:
        for fleet in self._fleets:
            fleet.close()
        self._crowd.kill()
        super().close()
