"""Others' ways to call what is in another process. Each is imported only when it is used."""

from __future__ import annotations

import statistics
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from tests.benchmarks.peers.peer import FRAME, GIVE_UP_S, HOST, ROBOTS, VALUE, AsyncPeer, SyncPeer, timed

# Pyro5: remote objects, a thread for each connection.


def pyro_daemon(port: int) -> Any:
    """Return a daemon with a hundred robots; its `requestLoop` serves them."""
    from Pyro5 import api, config

    config.SERIALIZER = "msgpack"  # the fastest that carries bytes as they are
    config.THREADPOOL_SIZE = 2 * ROBOTS

    @api.expose
    class Lamp:
        def get(self) -> bytes:
            return VALUE

        def command(self) -> int:
            return 1

        def frame(self) -> bytes:
            return FRAME

    daemon = api.Daemon(host=HOST, port=port)
    for robot in range(ROBOTS):
        daemon.register(Lamp(), f"lamp{robot}")
    return daemon


class Pyro(SyncPeer):
    """A proxy for each caller and each robot."""

    name = "Pyro5"
    package = "Pyro5"
    modules = ("Pyro5.api",)

    def _proxy(self, robot: int) -> Any:
        from Pyro5 import api, config

        config.SERIALIZER = "msgpack"
        proxy = api.Proxy(f"PYRO:lamp{robot}@{HOST}:{self.port}")
        proxy._pyroTimeout = GIVE_UP_S
        return proxy

    def handle(self) -> Any:
        return _ByCaller(lambda: self._proxy(0))

    def fan_out(self, count: int) -> float:
        """A proxy belongs to a thread, so that a hundred robots take a hundred threads."""
        with ThreadPoolExecutor(ROBOTS) as threads:
            robots = [_ByCaller(lambda robot=robot: self._proxy(robot)) for robot in range(ROBOTS)]

            def once() -> None:
                for call in [threads.submit(robot.command) for robot in robots]:
                    call.result(GIVE_UP_S)

            once()
            seconds = statistics.median(timed(once) for _ in range(count))
        for robot in robots:
            robot.close()
        return seconds

    def try_once(self) -> None:
        """A proxy connects anew by itself with its next call."""
        self._own.get()


class _ByCaller:
    """A proxy that whichever thread calls makes its own: that is how Pyro5 shares them."""

    def __init__(self, make: Any) -> None:
        self._proxy = make()

    def _owned(self) -> Any:
        self._proxy._pyroClaimOwnership()
        return self._proxy

    def get(self) -> None:
        self._owned().get()

    def command(self) -> None:
        self._owned().command()

    def frame(self) -> None:
        self._owned().frame()

    def close(self) -> None:
        self._owned()._pyroRelease()


# xoscar: actors in pools of processes.


async def serve_xoscar(port: int) -> Any:
    """Return a pool with a hundred actors; its `join` serves them."""
    import xoscar

    class Lamp(xoscar.Actor):  # type: ignore[misc]
        async def get(self) -> bytes:
            return VALUE

        async def command(self) -> int:
            return 1

        async def frame(self) -> bytes:
            return FRAME

    address = f"{HOST}:{port}"
    pool = await xoscar.create_actor_pool(address, n_process=0)
    for robot in range(ROBOTS):
        await xoscar.create_actor(Lamp, address=address, uid=f"lamp{robot}")
    return pool


class Xoscar(AsyncPeer):
    """References to actors."""

    name = "xoscar"
    package = "xoscar"
    modules = ("xoscar",)

    async def connect(self) -> None:
        import xoscar

        address = f"{HOST}:{self.port}"
        self._lamps = [await xoscar.actor_ref(address=address, uid=f"lamp{robot}") for robot in range(ROBOTS)]

    async def disconnect(self) -> None:
        self._lamps = []

    async def get_once(self) -> None:
        await self._lamps[0].get()

    async def command_once(self, robot: int) -> None:
        await self._lamps[robot].command()

    async def frame_once(self) -> None:
        await self._lamps[0].frame()


# viam-sdk: components behind gRPC, as its own Python server serves them.


async def serve_viam(port: int) -> None:
    """Serve a hundred sensors and a camera."""
    from viam.components.camera import Camera
    from viam.components.sensor import Sensor
    from viam.media.video import CameraMimeType, NamedImage
    from viam.proto.common import ResponseMetadata
    from viam.rpc.server import Server

    class Lamp(Sensor):  # type: ignore[misc]
        async def get_readings(self, **_: Any) -> dict[str, float]:
            return {"x": 0.0, "y": 0.0, "yaw": 0.0}

        async def do_command(self, command: Any, **_: Any) -> dict[str, int]:
            return {"status": 1}

    class Eye(Camera):  # type: ignore[misc]
        async def get_images(self, **_: Any) -> Any:
            return [NamedImage("eye", FRAME, CameraMimeType.VIAM_RGBA)], ResponseMetadata()

        async def get_point_cloud(self, **_: Any) -> Any:
            raise NotImplementedError

        async def get_properties(self, **_: Any) -> Any:
            raise NotImplementedError

    await Server([Eye("eye"), *(Lamp(f"lamp{robot}") for robot in range(ROBOTS))]).serve(HOST, port, log_level=None)


class Viam(AsyncPeer):
    """A gRPC channel to each robot."""

    name = "viam-sdk"
    package = "viam-sdk"
    modules = ("viam.rpc.server", "grpclib.client")

    async def connect(self) -> None:
        from grpclib.client import Channel
        from viam.components.camera.client import CameraClient
        from viam.components.sensor.client import SensorClient

        self._channels = [Channel(HOST, self.port) for _ in range(ROBOTS)]
        self._lamps = [SensorClient(f"lamp{robot}", channel) for robot, channel in enumerate(self._channels)]
        self._eye = CameraClient("eye", self._channels[0])

    async def disconnect(self) -> None:
        for channel in self._channels:
            channel.close()

    async def get_once(self) -> None:
        await self._lamps[0].get_readings()

    async def command_once(self, robot: int) -> None:
        await self._lamps[robot].do_command({"command": "on"})

    async def frame_once(self) -> None:
        await self._eye.get_images()
