"""The other ends: an AGV and a master made with vda5050-sdk, which others wrote, at a real mosquitto.

The SDK accepts orders, keeps the state and reports it; here is only the vehicle's motion, which is exact: the true path
is its own. Everything that passes the broker is checked against the schemas that the standard publishes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import socket
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import aiomqtt
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion
from vda5050 import MasterClient, MasterConfig, VehicleClient, VehicleConfig
from vda5050.client.agv.executor import OrderExecutor
from vda5050.model.factsheet import Factsheet
from vda5050.validation import default_validator

from tests.unit.plugins.mqtt.rig import Broker

_TICK_S = 0.02
MAP = "floor"


class Loop:
    """An asyncio loop in a thread of its own."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()

    def run(self, work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(60)

    def close(self) -> None:
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()


class _Driver(OrderExecutor):
    """Drives to nodes by the exact motion of the vehicle."""

    def __init__(self, agv: SdkAgv) -> None:
        super().__init__(agv.client.publisher)
        self._agv = agv

    async def visit_node(self, node: Any) -> None:
        await self._agv.go(node.node_position)


def _factsheet() -> Factsheet:
    return Factsheet(
        header_id=0,
        timestamp="1970-01-01T00:00:00.00Z",
        version="2.1.0",
        manufacturer="",
        serial_number="",
        vehicle_config={},
    )


class SdkAgv:
    """An AGV.

    Args:
        broker: its broker.
        serial: its serial number.
        pose: where it is at first.
        speed_m_s: its speed.
    """

    def __init__(
        self, broker: Broker, serial: str, pose: tuple[float, float, float] = (0.0, 0.0, 0.0), speed_m_s: float = 1.0
    ) -> None:
        self.pose = pose
        self.speed_m_s = speed_m_s
        self.path = [pose[:2]]
        self.orders: list[Any] = []
        self.actions: list[str] = []
        self._loop = Loop()
        self._running: asyncio.Task[Any] | None = None
        self._config = VehicleConfig(
            manufacturer="ACME", serial_number=serial, broker_url=f"mqtt://127.0.0.1:{broker.port}", state_interval=1.0
        )
        self.client: Any = None

    def __enter__(self) -> SdkAgv:
        self._loop.run(self._connect())
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.run(self._disconnect())
        self._loop.close()

    async def _connect(self) -> None:
        self.client = VehicleClient(self._config, factsheet_provider=_factsheet)
        self.client.on_order(self._take_order)
        self.client.on_instant_actions(self._take_actions)
        await self.client.connect()
        self._report()

    async def _disconnect(self) -> None:
        if self._running is not None:
            self._running.cancel()
        with contextlib.suppress(aiomqtt.MqttError):  # it was lost on purpose
            await self.client.disconnect()

    def _report(self) -> None:
        x, y, theta = self.pose
        battery = self.client.publisher.battery
        self.client.publisher.set_battery(battery.model_copy(update={"battery_voltage": 48.2}))
        self.client.update_position(x=x, y=y, theta=theta, map_id=MAP)

    async def _take_order(self, order: Any) -> None:
        self.orders.append(order)
        self._running = asyncio.ensure_future(_Driver(self).run(order))

    async def _take_actions(self, message: Any) -> None:
        self.actions += [action.action_type for action in message.actions]
        if "cancelOrder" in self.actions[-len(message.actions) :] and self._running is not None:
            self._running.cancel()

    @property
    def has_order(self) -> bool:
        """Whether it is at work on an order."""
        return self._running is not None and not self._running.done()

    async def go(self, goal: Any) -> None:
        """Drive straight to a place and turn there."""
        while math.dist(self.pose[:2], (goal.x, goal.y)) > 1e-9:
            await self._tick()
            if not self.client.publisher.paused:
                way = math.dist(self.pose[:2], (goal.x, goal.y))
                share = min(1.0, self.speed_m_s * _TICK_S / way)
                x, y, theta = self.pose
                self.pose = x + share * (goal.x - x), y + share * (goal.y - y), theta
                self.path.append(self.pose[:2])
        if goal.theta is not None:
            left = math.remainder(goal.theta - self.pose[2], math.tau)
            for _ in range(10):
                await self._tick()
                self.pose = (*self.pose[:2], self.pose[2] + left / 10)
        self._report()

    async def _tick(self) -> None:
        await asyncio.sleep(_TICK_S)
        self._report()

    def call(self, function: Callable[[], Any]) -> Any:
        """Run a function in the AGV's thread."""

        async def run() -> Any:
            return function()

        return self._loop.run(run())

    def lose(self) -> None:
        """Lose the connection without a farewell: the broker publishes the last will."""
        client = self.client._transport._client._client
        self.call(lambda: client.socket().shutdown(socket.SHUT_RDWR))


class SdkMaster:
    """A master control at a broker."""

    def __init__(self, broker: Broker) -> None:
        self._loop = Loop()
        self.client = MasterClient(
            MasterConfig(broker_url=f"mqtt://127.0.0.1:{broker.port}", visualization=True, validate_messages=True)
        )
        self.states: list[Any] = []
        self.connections: list[str] = []
        self.errors: list[Any] = []
        self.factsheets: list[Any] = []
        self.poses: list[Any] = []
        self.client.on_state(lambda state, _: self.states.append(state))
        self.client.on_connection(lambda one, _: self.connections.append(one.connection_state.value))
        self.client.on_error(lambda event: self.errors.append(event))
        self.client.on_factsheet(lambda one, _: self.factsheets.append(one))
        self.client.on_visualization(lambda one, _: self.poses.append(one.agv_position))

    def __enter__(self) -> SdkMaster:
        self.run(self.client.connect())
        return self

    def __exit__(self, *_: object) -> None:
        self.run(self.client.disconnect())
        self._loop.close()

    def run(self, work: Coroutine[Any, Any, Any]) -> Any:
        return self._loop.run(work)

    def state(self, serial: str) -> Any:
        """Return the newest state of a vehicle; None before the first."""
        return next((one for one in reversed(self.states) if one.serial_number == serial), None)

    def dispatch(self, order: Any) -> None:
        """Send an order, which its vehicle must accept."""
        accepted = self.run(self.client.dispatch(order, f"{order.manufacturer}/{order.serial_number}"))
        assert accepted.accepted, accepted


class Judge:
    """Hears everything at a broker, and checks it against the published schemas."""

    def __init__(self, broker: Broker) -> None:
        self.problems: list[str] = []
        self.counts: dict[str, int] = {}
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._take
        self._client.connect("127.0.0.1", broker.port)
        self._client.subscribe("uagv/#", 1)
        self._client.loop_start()

    def _take(self, _: Any, __: Any, message: Any) -> None:
        kind = message.topic.rpartition("/")[2]
        self.counts[kind] = self.counts.get(kind, 0) + 1
        self.problems += [f"{kind}: {one}" for one in default_validator().errors(kind, json.loads(message.payload))]

    def __enter__(self) -> Judge:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        assert not self.problems, self.problems[:5]
