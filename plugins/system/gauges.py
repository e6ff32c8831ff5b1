"""The gauges of a computer: sensors that are read now and again, and answer at once."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import psutil

from eal_actors.plugin import Activity, Clock, DataType, Resource, ResourceType, ValueInfo, request

BYTES: Final = ValueInfo(DataType.INT, "B", minimum=0)


class Cpu(Resource):
    """How busy the processor is, 0..1 of all its cores, over the last period.

    Args:
        period_s: how often it is read.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, minimum=0, maximum=1, description="share of the time of all cores")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._busy = 0.0

    def open(self) -> None:
        """Begin to count."""
        psutil.cpu_percent()

    def get_value(self) -> float:
        """Return how busy it is."""
        return self._busy

    def background(self) -> Activity:
        """Read it again and again."""
        while True:
            yield self._period_s
            self._busy = min(psutil.cpu_percent() / 100, 1.0)  # since the last call in this thread

    @request("cores", ValueInfo(DataType.INT, minimum=1, description="cores that programs can use"))
    def cores(self) -> int:
        """Tell how many cores there are, threads of cores counted too."""
        return psutil.cpu_count() or 1

    @request("load", ValueInfo(DataType.DOUBLE, shape=(3,), description="programs that run or want to"))
    def load(self) -> list[float]:
        """Tell the load average over 1, 5 and 15 minutes."""
        return list(psutil.getloadavg())


class Memory(Resource):
    """How full the memory is, 0..1; what programs could have at once counts as free."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, minimum=0, maximum=1, description="share of the memory")

    def get_value(self) -> float:
        """Return how full it is."""
        memory = psutil.virtual_memory()
        return 1 - memory.available / memory.total

    @request("total", BYTES)
    def total(self) -> int:
        """Tell the memory's size."""
        return psutil.virtual_memory().total

    @request("available", BYTES)
    def available(self) -> int:
        """Tell how much programs could have at once."""
        return psutil.virtual_memory().available


class Disk(Resource):
    """How full a file system is, 0..1, as ordinary users see it.

    Args:
        path: where it is mounted, or any path on it.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, minimum=0, maximum=1, description="share of the file system")

    def __init__(self, path: str) -> None:
        self._path = path

    def not_ready(self) -> str | None:
        """Return that the path is not there, such as a card that is pulled out."""
        return None if Path(self._path).exists() else f"{self._path} is not there: nothing is mounted"

    def get_value(self) -> float:
        """Return how full it is."""
        return psutil.disk_usage(self._path).percent / 100

    @request("total", BYTES)
    def total(self) -> int:
        """Tell the file system's size."""
        return psutil.disk_usage(self._path).total

    @request("free", BYTES)
    def free(self) -> int:
        """Tell how much ordinary users may still write."""
        return psutil.disk_usage(self._path).free


class Temperature(Resource):
    """The temperature of the hottest part that has a sensor.

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
        self._parts_c = _temperatures_c()

    def not_ready(self) -> str | None:
        """Return that there is no sensor, as in most virtual machines."""
        if self._parts_c:
            return None
        return "this computer shows no temperature: its operating system knows of no sensor"

    def get_value(self) -> float:
        """Return the temperature of the hottest part."""
        return max(self._parts_c.values())

    def background(self) -> Activity:
        """Read the sensors again and again."""
        while True:
            yield self._period_s
            self._parts_c = _temperatures_c()

    @request("parts", ValueInfo(DataType.CHAR, description="a JSON object"))
    def parts(self) -> str:
        """Tell the temperature of each part in degC, as a JSON object."""
        return json.dumps(self._parts_c)


def _temperatures_c() -> dict[str, float]:
    """Return the temperatures of the parts; none where the system has no way to tell."""
    sensors: dict[str, list[Any]] = getattr(psutil, "sensors_temperatures", dict)()
    found: dict[str, float] = {}
    for chip, readings in sensors.items():
        for number, reading in enumerate(readings):
            found[f"{chip} {reading.label or number}"] = float(reading.current)
    return found


class Network(Resource):
    """What comes in and goes out in a second, over the last period.

    Args:
        interface: which; None for all but the loopback.
        clock: the fleet's clock.
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
        """Look whether the interface is there."""
        self._is_there = self._counters() is not None

    def not_ready(self) -> str | None:
        """Return that there is no such interface, such as an adapter that is pulled out."""
        if self._is_there:
            return None
        there = ", ".join(sorted(psutil.net_io_counters(pernic=True))) or "none"
        return f"there is no network interface {self._interface!r} now; there are: {there}"

    def get_value(self) -> list[float]:
        """Return the bytes received and sent in a second."""
        return list(self._rates)

    def background(self) -> Activity:
        """Count again and again."""
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
        """Tell how many bytes have come in since it was switched on."""
        return (self._counters() or (0, 0))[0]

    @request("sent", BYTES)
    def sent(self) -> int:
        """Tell how many bytes have gone out since it was switched on."""
        return (self._counters() or (0, 0))[1]

    @request("addresses", ValueInfo(DataType.CHAR, description="a JSON object"))
    def addresses(self) -> str:
        """Tell the addresses of each interface, as a JSON object."""
        found = {name: [address.address for address in had] for name, had in psutil.net_if_addrs().items()}
        return json.dumps(found)

    def _counters(self) -> tuple[int, int] | None:
        """Return the bytes received and sent; None if the interface is not there."""
        counters = psutil.net_io_counters(pernic=True)
        if self._interface is not None:
            counters = {name: counted for name, counted in counters.items() if name == self._interface}
            if not counters:
                return None
        outside = [counted for name, counted in counters.items() if self._interface or not name.startswith("lo")]
        return sum(counted.bytes_recv for counted in outside), sum(counted.bytes_sent for counted in outside)


class Uptime(Resource):
    """How long the computer has been on."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "s", minimum=0)

    def get_value(self) -> float:
        """Return how long."""
        return max(datetime.now(UTC).timestamp() - psutil.boot_time(), 0.0)
