"""MavLink: the link to one vehicle: its newest messages, our heartbeat, set-points and commands.

Our heartbeat goes out once a second while the link is open. An autopilot stops when it ceases, or when set-points cease
(ArduPilot after 3 s, PX4 after a second): that is the dead-man of a program that is killed.

Thread: any; a thread of its own reads the port.
"""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from eal_actors.plugin import (
    Activity,
    BytePort,
    EALError,
    LogLimit,
    OdometryNoise,
    PluginContext,
    ReopeningPort,
    ResourceFaultError,
    UnavailableError,
    get_logger,
    is_plausible,
    open_serial,
    open_tcp,
    wrapped_rad,
)

from . import protocol
from .settings import Settings
from .udp_listener import UdpListener

_READ_S: Final = 0.01
_HEARTBEAT_S: Final = 1.0
_MOST_READS: Final = 50
"""Reads in a turn of the thread, so that a flood does not keep our heartbeat back."""
_MOST_ROUNDS: Final = 10
"""Times as many are read before the vehicle is called silent."""
_PAUSE_S: Final = 0.2
_PERIODS_US: Final = {
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 50_000,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1_000_000,
}
_TRIES: Final = 3
_TRY_S: Final = 1.0
_PROGRESS_S: Final = 5.0
"""Wait for the result of a command that is under way: sent again, it would begin again."""
_POLL_S: Final = 0.02
_ACCEPTED: Final = 0
_IN_PROGRESS: Final = 5
_UNCHANGED: Final = -1.0
_NOISE: Final = OdometryNoise(scale_share=1e-4, drift_rad_m=1e-4, turn_share=1e-4)
"""The autopilot estimates its own pose."""


@dataclass(frozen=True, slots=True)
class VehicleReading:
    """Where the vehicle is, in the map.

    Attributes:
        x_m: position.
        y_m: likewise.
        altitude_m: above its start.
        yaw_rad: heading; it counts turns.
        speed_m_s: over ground.
        turn_rate_rad_s: to the left.
        stamp_s: by the fleet's clock.
    """

    x_m: float
    y_m: float
    altitude_m: float
    yaw_rad: float
    speed_m_s: float
    turn_rate_rad_s: float
    stamp_s: float

    @property
    def is_still(self) -> bool:
        """Whether the vehicle stands."""
        return self.speed_m_s < 0.03 and abs(self.turn_rate_rad_s) < 0.03


class MavLink:
    """The link to one vehicle."""

    def __init__(self, context: PluginContext, settings: Settings) -> None:
        self._settings = settings
        self._clock = context.clock
        self._localizer = context.localizer
        self._log = get_logger(robot=context.robot)
        self._port = ReopeningPort(lambda: _open(settings), context.clock, settings.port)
        self._codec: Any = mavlink.MAVLink(None, settings.own_system_id, 190)
        self._codec.robust_parsing = True
        self._send_lock = threading.Lock()
        self._read_lock = threading.RLock()
        self._newest: dict[str, tuple[Any, float]] = {}
        self._acknowledged: dict[int, int] = {}
        self._reading: VehicleReading | None = None
        self._attitude: tuple[float, float] | None = None
        self._is_asked = False
        self._set_point_s = -math.inf
        self._kept_until_s: float | None = None
        self._texts: list[str] = []
        self._said = LogLimit()
        self._localizer.attach(_NOISE, not_ready=self.why_not_ready)
        self._end = threading.Event()
        self._port.open()
        self._thread = threading.Thread(target=self._run, name=f"mavlink {context.robot}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the link; our heartbeat ceases."""
        self._end.set()
        with self._clock.outside():
            self._thread.join(1.0)
        self._port.close()

    # The thread.

    def _run(self) -> None:
        next_s, is_heard, is_full = 0.0, False, False
        while not self._end.wait(0.0 if is_full else _READ_S):
            is_full = False
            now_s = self._clock.now()
            try:
                if now_s >= next_s:  # first: broken bytes must not keep it back
                    next_s = now_s + _HEARTBEAT_S
                    self._send(self._codec.heartbeat_encode(protocol.GROUND_STATION, 8, 0, 0, 4))
                    if is_heard:
                        self._ask_for_rates()
                is_full = self._read()
                if not is_heard and "HEARTBEAT" in self._newest:  # before it, a datagram has no address to go to
                    is_heard, next_s = True, 0.0
                self._fill_pause()
            except EALError:  # the port is reopened
                continue
            except Exception:  # noqa: BLE001  # the thread is the dead-man: it must outlive every message
                self._log.exception("a MAVLink message was not understood")

    def _read(self) -> bool:
        """Take what has arrived; returns whether there may be more. Thread: any; one at a time."""
        with self._read_lock:
            for _ in range(_MOST_READS):
                data = self._port.read(4096)
                if not data:
                    return False
                for message in self._codec.parse_buffer(data) or ():
                    self._take(message)
        return True

    def _fill_pause(self) -> None:
        """Send a velocity of zero in a pause between set-points, while OFFBOARD is to be kept."""
        now_s = self._clock.now()
        if self._kept_until_s is None or now_s - self._set_point_s < _PAUSE_S:
            return
        if self.mode() == protocol.OFFBOARD:
            self._kept_until_s = -math.inf  # reached: from now on, who leaves it ends this at once
        elif now_s > self._kept_until_s:
            self._kept_until_s = None
            return
        self.send_velocity(0.0, 0.0)

    def _ask_for_rates(self) -> None:
        """Ask for the sensors' messages; again after a silence: the vehicle may have restarted, or not heard it."""
        is_silent = self._silence() is not None
        if self._is_asked and not is_silent:
            return
        self._is_asked = not is_silent
        for number, period_us in _PERIODS_US.items():
            self._send_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, period_us)

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        source = self._settings.system_id, protocol.AUTOPILOT
        if kind == "BAD_DATA" or (message.get_srcSystem(), message.get_srcComponent()) != source:
            return
        if (problem := _problem(kind, message)) is not None:
            self._log_once(problem)
            return
        now_s = self._clock.now()
        if kind == "COMMAND_ACK":
            if message.target_system in (0, self._settings.own_system_id):  # 0: it does not say whom it answers
                self._acknowledged[message.command] = message.result
        elif kind == "STATUSTEXT":
            if (more := self._said.admit()) is not None:
                self._log.info("the autopilot says", text=message.text, **more)
        elif kind == "ATTITUDE":
            self._attitude = message.yaw, message.yawspeed
        elif kind == "LOCAL_POSITION_NED" and self._attitude is not None:
            self._follow(message, *self._attitude, now_s)
        self._newest[kind] = message, now_s

    def _log_once(self, text: str) -> None:
        if text not in self._texts:
            self._texts.append(text)
            self._log.warning(text)

    def _follow(self, message: Any, heading_rad: float, yawspeed: float, now_s: float) -> None:
        x_m, y_m, yaw_rad = protocol.map_pose(message.x, message.y, heading_rad)
        before = self._reading
        if before is None:
            self._localizer.begin_at(x_m, y_m, yaw_rad)
        turned = yaw_rad if before is None else before.yaw_rad + wrapped_rad(yaw_rad - before.yaw_rad)
        speed = math.hypot(message.vx, message.vy)
        self._reading = VehicleReading(x_m, y_m, -message.z, turned, speed, -yawspeed, now_s)
        self._localizer.odometry(x_m, y_m, yaw_rad, now_s)

    # What the vehicle says.

    def newest(self, kind: str) -> Any:
        """Return the newest message of a kind.

        Raises:
            UnavailableError: there is none, or the vehicle is silent.
        """
        if (problem := self.why_not_ready()) is not None:
            raise UnavailableError(problem)
        if kind not in self._newest:
            raise UnavailableError(f"the vehicle has sent no {kind}")
        return self._newest[kind][0]

    def why_not_ready(self) -> str | None:
        """Return why the vehicle cannot be reached now."""
        if (problem := self._port.why_not_ready()) is not None:
            return problem
        with suppress(EALError):  # if this program stood still, what the vehicle has said since waits to be read
            for _ in range(_MOST_ROUNDS):
                if self._silence() is None or not self._read():
                    break
        return self._silence()

    def _silence(self) -> str | None:
        """Return which message is missing or too old."""
        system, now_s = self._settings.system_id, self._clock.now()
        limits_s = {"HEARTBEAT": self._settings.timeout_s, "LOCAL_POSITION_NED": self._settings.odometry_timeout_s}
        for kind, limit_s in limits_s.items():
            if kind not in self._newest:
                return f"system {system} has sent no {kind} at {self._settings.port}"
            age_s = now_s - self._newest[kind][1]
            if age_s > limit_s:
                return f"system {system} has sent no {kind} for {age_s:.1f} s"
        return None if self._reading is not None else f"system {system} has sent no ATTITUDE"

    def reading(self) -> VehicleReading:
        """Return where the vehicle is.

        Raises:
            UnavailableError: it is silent.
        """
        problem = self.why_not_ready()
        if problem is not None or self._reading is None:
            raise UnavailableError(problem or "no position has arrived")
        return self._reading

    def is_armed(self) -> bool:
        """Return whether the motors are armed. Raises what `newest` raises."""
        return bool(self.newest("HEARTBEAT").base_mode & protocol.ARMED)

    def mode(self) -> str:
        """Return the mode's name. Raises what `newest` raises."""
        heartbeat = self.newest("HEARTBEAT")
        return protocol.mode_name(heartbeat.autopilot, self._settings.vehicle, heartbeat.custom_mode)

    def autopilot(self) -> int:
        """Return the number of the autopilot's make. Raises what `newest` raises."""
        found: int = self.newest("HEARTBEAT").autopilot
        return found

    # What is said to it.

    def _send(self, message: Any) -> None:
        with self._send_lock:
            self._port.write(message.pack(self._codec))
            self._codec.seq = (self._codec.seq + 1) % 256

    def send_velocity(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Send a velocity ahead and a turn rate to the left.

        Raises:
            UnavailableError: the link is down.
        """
        self._set_point(protocol.BODY_NED, protocol.VELOCITY_MASK, (0.0, 0.0, 0.0), speed_m_s, 0.0, -turn_rate_rad_s)

    def keep_offboard(self, timeout_s: float) -> None:
        """Fill pauses between set-points with a velocity of zero: PX4 leaves OFFBOARD after a second without any.

        It ends when the vehicle is in another mode; it must be in OFFBOARD within the time-out, by the fleet's clock.
        """
        self._kept_until_s = self._clock.now() + timeout_s

    def send_position(self, x_m: float, y_m: float, altitude_m: float, yaw_rad: float | None) -> None:
        """Send a place in the map to drive or fly to.

        Raises:
            UnavailableError: the link is down.
        """
        mask = protocol.POSITION_MASK if yaw_rad is None else protocol.POSE_MASK
        heading = 0.0 if yaw_rad is None else protocol.heading_rad(yaw_rad)
        self._set_point(protocol.LOCAL_NED, mask, (y_m, x_m, -altitude_m), 0.0, heading, 0.0)

    def _set_point(
        self, frame: int, mask: int, place: tuple[float, float, float], vx: float, yaw: float, yaw_rate: float
    ) -> None:
        self._set_point_s = self._clock.now()
        system, time_ms = self._settings.system_id, int(self._set_point_s * 1000) & 0xFFFFFFFF
        message = self._codec.set_position_target_local_ned_encode(
            time_ms, system, protocol.AUTOPILOT, frame, mask, *place, vx, 0.0, 0.0, 0.0, 0.0, 0.0, yaw, yaw_rate
        )
        self._send(message)

    def request_speed(self, speed_m_s: float) -> None:
        """Ask for a speed on the way to the present place; not every autopilot follows.

        Raises:
            UnavailableError: the link is down.
        """
        self._send_command(mavlink.MAV_CMD_DO_CHANGE_SPEED, mavlink.SPEED_TYPE_GROUNDSPEED, speed_m_s, _UNCHANGED)

    def _send_command(self, number: int, *parameters: float, tries: int = 0) -> None:
        filled = [*map(float, parameters), *[0.0] * (7 - len(parameters))]
        system, component = self._settings.system_id, protocol.AUTOPILOT
        self._send(self._codec.command_long_encode(system, component, number, tries, *filled))

    def command(self, what: str, number: int, *parameters: float) -> Activity:
        """Send a command until it is acknowledged.

        Raises:
            ResourceFaultError: the autopilot refuses it.
            UnavailableError: it does not answer.
        """
        for tries in range(_TRIES):
            self._acknowledged.pop(number, None)
            self._send_command(number, *parameters, tries=tries)
            end_s = self._clock.now() + _TRY_S
            while self._clock.now() < end_s:
                result = self._acknowledged.pop(number, None)
                if result == _ACCEPTED:
                    return
                if result == _IN_PROGRESS:
                    end_s = self._clock.now() + _PROGRESS_S
                elif result is not None:
                    name = mavlink.enums["MAV_RESULT"][result].name if result in mavlink.enums["MAV_RESULT"] else result
                    raise ResourceFaultError(f"the autopilot refuses to {what}: {name}")
                yield _POLL_S
        raise UnavailableError(f"the autopilot does not answer the command to {what}")


def _open(settings: Settings) -> BytePort:
    scheme, separator, rest = settings.port.partition("://")
    if not separator:
        return open_serial(settings.port, baudrate=settings.baud)
    host, _, port = rest.rpartition(":")
    if scheme == "udp":
        return UdpListener(host, int(port), settings.system_id)
    return open_tcp(host, int(port))


def _problem(kind: str, message: Any) -> str | None:
    """Return why a message is ignored; None if it is not."""
    is_place = kind == "LOCAL_POSITION_NED"
    if is_place or kind == "ATTITUDE":
        fields = [value for value in message.to_dict().values() if isinstance(value, float)]
        if not all(map(math.isfinite, fields)):
            return f"a {kind} that is not finite is ignored"
    if is_place and not is_plausible(message.x, message.y, message.z):
        return "positions over 1,000 km from the start are ignored"
    return None
