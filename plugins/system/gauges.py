"""The gauges of a computer: sensors that are polled, and answer at once."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import psutil

from eal_actors.plugin import Activity, Clock, DataType, Resource, ResourceType, ValueInfo, request

BYTES: Final = ValueInfo(DataType.INT, "B", minimum=0)


class Cpu(Resource):
    """Processor load, 0..1 of all cores, over the last period.

    Args:
        period_s: how often it is read.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, minimum=0, maximum=1, description="share of the time of all cores")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._busy = 0.0

    def open(self) -> None:
        """Begin to measure."""
        psutil.cpu_percent()

    def get_value(self) -> float:
        """Return the load."""
        return self._busy

    def background(self) -> Activity:
        """Poll the load."""
        while True:
            yield self._period_s
            self._busy = min(psutil.cpu_percent() / 100, 1.0)  # since the last call in this thread

    @request("cores", ValueInfo(DataType.INT, minimum=1, description="cores that programs can use"))
    def cores(self) -> int:
        """Return the number of logical cores."""
        return psutil.cpu_count() or 1

    @request("load", ValueInfo(DataType.DOUBLE, shape=(3,), description="programs that run or want to"))
    def load(self) -> list[float]:
        """Return the load average over 1, 5 and 15 minutes."""
        return list(psutil.getloadavg())


class Memory(Resource):
    """Memory use, 0..1; memory available to programs counts as free."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, minimum=0, maximum=1, description="share of the memory")

    def get_value(self) -> float:
        """Return how full it is."""
        memory = psutil.virtual_memory()
        return 1 - memory.available / memory.total

    @request("total", BYTES)
    def total(self) -> int:
        """Return the memory's size."""
        return psutil.virtual_memory().total

    @request("available", BYTES)
    def available(self) -> int:
        """Return the memory available to programs."""
        return psutil.virtual_memory().available


class Disk(Resource):
    """Use of a file system, 0..1, for ordinary users.

    Args:
        path: where it is mounted, or any path on it.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, minimum=0, maximum=1, description="share of the file system")

    def __init__(self, path: str) -> None:
        self._path = path

    def not_ready(self) -> str | None:
        """Return that the path is missing, such as a removed card."""
        return None if Path(self._path).exists() else f"{self._path} is not there: nothing is mounted"

    def get_value(self) -> float:
        """Return how full it is."""
        return psutil.disk_usage(self._path).percent / 100

    @request("total", BYTES)
    def total(self) -> int:
        """Return the file system's size."""
        return psutil.disk_usage(self._path).total

    @request("free", BYTES)
    def free(self) -> int:
        """Return the space available to ordinary users."""
        return psutil.disk_usage(self._path).free


class Temperature(Resource):
    """The temperature of the hottest component with a sensor.

    Args:
        period_s: how often the sensors are read: some take their time.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "degC")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._parts_c: dict[str, float] = {}

    def open(self) -> None:
        """Read the sensors."""
        self._parts_c = temperatures_c()

    def not_ready(self) -> str | None:
        """Return that there is no sensor, as in most virtual machines."""
        if self._parts_c:
            return None
        return "this computer shows no temperature: its operating system knows of no sensor"

    def get_value(self) -> float:
        """Return the temperature of the hottest component."""
        return max(self._parts_c.values())

    def background(self) -> Activity:
        """Poll the sensors."""
        while True:
            yield self._period_s
            self._parts_c = temperatures_c()

    @request("parts", ValueInfo(DataType.CHAR, description="a JSON object"))
    def parts(self) -> str:
        """Return the temperature of each component in degC, as a JSON object."""
        return json.dumps(self._parts_c)


def temperatures_c() -> dict[str, float]:
    """Return the temperatures of the components; empty if the system does not report any."""
    sensors: dict[str, list[Any]] = getattr(psutil, "sensors_temperatures", dict)()
    found: dict[str, float] = {}
    for chip, readings in sensors.items():
        for number, reading in enumerate(readings):
            found[f"{chip} {reading.label or number}"] = float(reading.current)
    return found


class Network(Resource):
    """Bytes received and sent per second, over the last period.

    Args:
        interface: which; None for all but the loopback.
        period_s: how often it is read.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "B/s", shape=(2,), description="received, sent")

    def __init__(self, interface: str | None, clock: Clock, period_s: float) -> None:
        self._interface = interface
        self._clock = clock
        self._period_s = period_s
        self._rates = [0.0, 0.0]
        self._is_there = True

    def open(self) -> None:
        """Check that the interface exists."""
        self._is_there = self._counters() is not None

    def not_ready(self) -> str | None:
        """Return that the interface is missing, such as an unplugged adapter."""
        if self._is_there:
            return None
        there = ", ".join(sorted(psutil.net_io_counters(pernic=True))) or "none"
        return f"there is no network interface {self._interface!r} now; there are: {there}"

    def get_value(self) -> list[float]:
        """Return the bytes received and sent per second."""
        return list(self._rates)

    def background(self) -> Activity:
        """Poll the counters."""
        before, before_s = self._counters(), self._clock.now()
        while True:
            yield self._period_s
            counted, now_s = self._counters(), self._clock.now()
            self._is_there = counted is not None
            if before is not None and counted is not None and now_s > before_s:
                pairs = zip(counted, before, strict=True)
                self._rates = [max(now - then, 0) / (now_s - before_s) for now, then in pairs]
            before, before_s = counted, now_s

    @request("received", BYTES)
    def received(self) -> int:
        """Return the bytes received since boot."""
        return (self._counters() or (0, 0))[0]

    @request("sent", BYTES)
    def sent(self) -> int:
        """Return the bytes sent since boot."""
        return (self._counters() or (0, 0))[1]

    @request("addresses", ValueInfo(DataType.CHAR, description="a JSON object"))
    def addresses(self) -> str:
        """Return the addresses of each interface, as a JSON object."""
        found = {name: [address.address for address in had] for name, had in psutil.net_if_addrs().items()}
        return json.dumps(found)

    def _counters(self) -> tuple[int, int] | None:
        """Return the bytes received and sent; None if the interface is missing."""
        counters = psutil.net_io_counters(pernic=True)
        if self._interface is not None:
            counters = {name: counted for name, counted in counters.items() if name == self._interface}
            if not counters:
                return None
        outside = [counted for name, counted in counters.items() if self._interface or not name.startswith("lo")]
        return sum(counted.bytes_recv for counted in outside), sum(counted.bytes_sent for counted in outside)


class Uptime(Resource):
    """The time since boot."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "s", minimum=0)

    def get_value(self) -> float:
        """Return the time since boot."""
        return max(datetime.now(UTC).timestamp() - psutil.boot_time(), 0.0)
