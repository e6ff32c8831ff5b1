"""FleetMetrics: Prometheus metrics of the robots that this process runs or commands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any, Final, Self

from prometheus_client import CollectorRegistry, Counter, Histogram, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from typing_extensions import override

from eal_actors.actors.call import Call
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import UnavailableError
from eal_actors.operate.metrics.call_observer import DONE, observe_calls

LOOPBACK: Final = "127.0.0.1"
_BUCKETS_S: Final = (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
"""From a call within the process to a command that drives for a while."""
_CLOSE_S: Final = 2.0


class FleetMetrics:
    """Counts the calls of robots, and serves metrics on loopback, for the length of a `with` block.

    The mapping of `robots` may change. `port` is 0 for any free one. `dead_man_trips` are halts because of a silent
    controller, by resource, of the one robot that is served. Raises UnavailableError if the port is in use.
    """

    def __init__(
        self,
        robots: Mapping[str, RobotHandle],
        clock: Clock,
        port: int,
        dead_man_trips: Mapping[str, int] | None = None,
    ) -> None:
        self.port = port
        self._registry = CollectorRegistry()
        labels, about = ("robot", "resource", "method"), "Seconds from call to answer, by the fleet's clock."
        self._calls = Counter("eal_calls", "Calls that ended.", (*labels, "outcome"), registry=self._registry)
        self._seconds = Histogram("eal_call_seconds", about, labels, buckets=_BUCKETS_S, registry=self._registry)
        self._frames = Counter("eal_frames", "Pictures read.", ("robot", "resource"), registry=self._registry)
        self._registry.register(_StateCollector(robots, dead_man_trips))
        self._observation = observe_calls(clock, self._count)
        self._stack = ExitStack()

    @property
    def url(self) -> str:
        """The URL to scrape."""
        return f"http://{LOOPBACK}:{self.port}/metrics"

    def _count(self, call: Call[Any], outcome: str, seconds: float) -> None:
        robot, resource = call.cell.robot, call.cell.name
        self._calls.labels(robot, resource, call.method, outcome).inc()
        self._seconds.labels(robot, resource, call.method).observe(seconds)
        if call.method == "get_value" and outcome == DONE and _is_picture(call.get()):
            self._frames.labels(robot, resource).inc()

    def __enter__(self) -> Self:
        try:
            server, thread = start_http_server(self.port, LOOPBACK, self._registry)
        except OSError as error:
            raise UnavailableError(f"metrics cannot be served at port {self.port}: {error.strerror}") from error
        self.port = server.server_port
        self._stack.callback(thread.join, _CLOSE_S)
        self._stack.callback(server.server_close)
        self._stack.callback(server.shutdown)
        self._stack.enter_context(self._observation)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def _is_picture(value: Any) -> bool:
    return isinstance(value, EALData) and value.type is DataType.CHAR and len(value.shape or ()) == 3


class _StateCollector(Collector):
    """The current state, read at each scrape without asking the robots. Thread: the server's."""

    def __init__(self, robots: Mapping[str, RobotHandle], dead_man_trips: Mapping[str, int] | None) -> None:
        self._robots = robots
        self._trips = dead_man_trips

    @override
    def collect(self) -> Iterable[Metric]:
        robots = list(self._robots.values())
        yield from _robot_metrics(robots)
        yield from _resource_metrics(robots)
        if self._trips is not None:
            labels, about = ("robot", "resource"), "Halts because a controller was silent."
            trips = CounterMetricFamily("eal_dead_man_trips", about, labels=labels)
            for robot in robots:
                for name in robot:
                    trips.add_metric((robot.name, name), self._trips.get(name, 0))
            yield trips

    def describe(self) -> Iterable[Metric]:
        """Return nothing, so that registration reads no robot."""
        return ()


def _robot_metrics(robots: Iterable[RobotHandle]) -> Iterator[Metric]:
    state = GaugeMetricFamily(
        "eal_robot_state", "1 for the current state of the robot or of the link to it.", labels=("robot", "state")
    )
    stopped = GaugeMetricFamily("eal_emergency_stop", "1 during an emergency stop.", labels=("robot",))
    running = GaugeMetricFamily("eal_commands_running", "Running commands.", labels=("robot",))
    for robot in robots:
        now = robot.state
        for each in RobotState:
            state.add_metric((robot.name, each.value), float(each is now))
        stopped.add_metric((robot.name,), float(robot.stopped_because is not None))
        running.add_metric((robot.name,), len(robot.running))
    yield from (state, stopped, running)


def _resource_metrics(robots: Iterable[RobotHandle]) -> Iterator[Metric]:
    labels = ("robot", "resource")
    depth = GaugeMetricFamily("eal_mailbox_depth", "Waiting calls, of robots of this process.", labels=labels)
    oldest = GaugeMetricFamily(
        "eal_mailbox_oldest_seconds", "Waiting time of the oldest call, by the fleet's clock.", labels=labels
    )
    restarts = CounterMetricFamily("eal_restarts", "Restarts of the resource's actor.", labels=labels)
    not_ready = GaugeMetricFamily("eal_not_ready", "1 while the resource's device cannot be used.", labels=labels)
    for robot in robots:
        restarted, absent = robot.restarts, robot.not_ready
        for name, handle in robot.items():
            restarts.add_metric((robot.name, name), restarted.get(name, 0))
            not_ready.add_metric((robot.name, name), float(name in absent))
            if (waiting := handle.waiting) is not None:
                depth.add_metric((robot.name, name), waiting.count)
                oldest.add_metric((robot.name, name), waiting.oldest_s)
    yield from (depth, oldest, restarts, not_ready)
