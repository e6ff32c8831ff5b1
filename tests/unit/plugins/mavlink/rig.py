"""The other end: a vehicle made with pymavlink's own server side, which behaves as ArduPilot documents.

It takes set-points in GUIDED when armed, stops when velocities cease for a second, holds when the ground station's
heartbeat ceases for five, and answers commands. A rover ignores the yaw of a position, and takes a speed only on its
way to one. Its motion is exact: the true path is its own.

`Px4Vehicle` has PX4's modes and rules.

Source: ArduPilot's documents of guided modes; PX4's of flight modes and of Offboard, and its px4_custom_mode.h.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
import tty
from typing import Any, Self

from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from eal_actors.kernel.clock import REAL_TIME

TICK_S = 0.02
SET_POINT_S = 1.0
STATION_S = 5.0
MODES = {"rover": (10, 15, 4), "copter": (2, 4, 17)}
"""MAV_TYPE, GUIDED and the mode in which it holds."""


def connection(address: str) -> Any:
    """Return pymavlink's end of a vehicle: `udpout:HOST:PORT` or `tcpin:HOST:PORT`."""
    return mavutil.mavlink_connection(address, source_system=1, source_component=1, dialect="common")


class SerialWire(mavutil.mavfile):  # type: ignore[misc]  # pymavlink has no types
    """A pseudo-terminal: the ground station opens `path`."""

    def __init__(self) -> None:
        mavutil.set_dialect("common")
        self.port, self._other = os.openpty()
        tty.setraw(self.port)
        os.set_blocking(self.port, False)
        self.path = os.ttyname(self._other)
        super().__init__(self.port, self.path, source_system=1, source_component=1)

    def recv(self, n: int | None = None) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self.port, n or self.mav.bytes_needed())
        return b""

    def write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):  # nobody reads
            os.write(self.port, data)

    def close(self) -> None:
        os.close(self.port)
        os.close(self._other)


class Vehicle:
    """A rover or copter.

    Args:
        wire: the UDP port where the ground station listens; or a connection of pymavlink.
        kind: rover or copter.
        pose: x east, y north in m, yaw counter-clockwise from east.
        speed_m_s: at which it goes to positions.

    Attributes:
        streams: the numbers of the messages that it sends unasked; None for all.
    """

    autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA

    def __init__(
        self,
        wire: int | Any,
        kind: str = "rover",
        pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
        speed_m_s: float = 1.0,
    ) -> None:
        self.wire: Any = connection(f"udpout:127.0.0.1:{wire}") if isinstance(wire, int) else wire
        self.type, self._guided, self._hold = MODES[kind]
        self.pose, self.altitude_m = pose, 0.0
        self.path = [pose[:2]]
        self.speed_m_s = speed_m_s
        self.mode = self._hold
        self.is_armed = False
        self.twist = (0.0, 0.0)
        self.goal: tuple[float, float, float, float | None] | None = None
        self.set_points = 0
        self.refuses: set[int] = set()
        self.streams: set[int] | None = None
        self.voltage_mv = 12100
        self.is_mute = False
        self._set_point_s = self._station_s = -math.inf
        self._vertical_m: float | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        self.wire.close()

    def say(self, data: bytes) -> None:
        """Send bytes as they are."""
        self.wire.write(data)

    def _run(self) -> None:
        beat_s = 0.0
        while not self._end.wait(TICK_S):
            now_s = REAL_TIME.now()
            while (message := self.wire.recv_match(blocking=False)) is not None:
                self._take(message, now_s)
            self._move(now_s)
            if self.is_mute:
                continue
            if now_s >= beat_s:
                beat_s = now_s + 0.5
                self.heartbeat()
                if self._sends(mavlink.MAVLINK_MSG_ID_SYS_STATUS):
                    self.wire.mav.sys_status_send(0, 0, 0, 0, self.voltage_mv, -1, 75, 0, 0, 0, 0, 0, 0)
            self.report(int(now_s * 1000) & 0xFFFFFFFF)

    def heartbeat(self) -> None:
        mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.is_armed else 0)
        self.wire.mav.heartbeat_send(self.type, self.autopilot, mode, self.mode, 4)

    def report(self, time_ms: int) -> None:
        x, y, yaw = self.pose
        speed, rate = self.twist
        heading = math.pi / 2 - yaw
        if self._sends(mavlink.MAVLINK_MSG_ID_ATTITUDE):
            self.wire.mav.attitude_send(time_ms, 0, 0, math.remainder(heading, math.tau), 0, 0, -rate)
        north, east = speed * math.cos(heading), speed * math.sin(heading)
        if self._sends(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
            self.wire.mav.local_position_ned_send(time_ms, y, x, -self.altitude_m, north, east, 0)

    def _sends(self, number: int) -> bool:
        return self.streams is None or number in self.streams

    def _take(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._station_s = now_s
        elif kind == "COMMAND_LONG" and message.target_system == 1:
            self._command(message, message.get_srcSystem(), message.get_srcComponent())
        elif kind == "SET_POSITION_TARGET_LOCAL_NED" and self.is_armed and self.mode == self._guided:
            self._set_point_s, self.set_points = now_s, self.set_points + 1
            if message.type_mask & 7:
                assert message.coordinate_frame == mavlink.MAV_FRAME_BODY_NED
                self.twist, self.goal = (message.vx, -message.yaw_rate), None
            else:
                assert message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED
                has_yaw = self.type == mavlink.MAV_TYPE_QUADROTOR and not message.type_mask & 1024
                yaw = math.pi / 2 - message.yaw if has_yaw else None
                self.goal = message.y, message.x, -message.z, yaw

    def _command(self, message: Any, system: int, component: int) -> None:
        number, result = message.command, mavlink.MAV_RESULT_ACCEPTED
        if number in self.refuses:
            result = mavlink.MAV_RESULT_DENIED
        elif number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.is_armed = message.param1 == 1
        elif number == mavlink.MAV_CMD_DO_SET_MODE:
            result = self.set_mode(int(message.param2), int(message.param3))
        elif number == mavlink.MAV_CMD_NAV_TAKEOFF:
            self._vertical_m = self.takeoff_m(message.param7)
        elif number == mavlink.MAV_CMD_NAV_LAND:
            self._vertical_m = 0.0
        elif number == mavlink.MAV_CMD_DO_CHANGE_SPEED and self.goal is not None:
            self.speed_m_s = message.param2
        elif number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            if self.streams is not None:
                self.streams.add(int(message.param1))
        else:
            result = mavlink.MAV_RESULT_UNSUPPORTED
        self.wire.mav.command_ack_send(number, result, 0, 0, system, component)

    def set_mode(self, mode: int, _: int) -> int:
        """Switch the mode; returns the MAV_RESULT."""
        self.mode = mode
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def takeoff_m(self, parameter_m: float) -> float:
        """Return the altitude above the start that a take-off means."""
        return parameter_m

    def _move(self, now_s: float) -> None:
        if now_s - self._station_s > STATION_S and self.mode == self._guided:
            self.mode = self._hold
        if now_s - self._set_point_s > SET_POINT_S or self.mode != self._guided or not self.is_armed:
            self.twist, self.goal = (0.0, 0.0), None
        if self._vertical_m is not None:
            left = self._vertical_m - self.altitude_m
            self.altitude_m += max(-0.05, min(0.05, left))
            if abs(left) < 1e-6 and self._vertical_m == 0.0:
                self.is_armed, self._vertical_m = False, None
        if self.goal is not None:
            self._approach(*self.goal)
        x, y, yaw = self.pose
        speed, rate = self.twist
        middle = yaw + rate * TICK_S / 2
        self.pose = x + speed * math.cos(middle) * TICK_S, y + speed * math.sin(middle) * TICK_S, yaw + rate * TICK_S
        self.path.append(self.pose[:2])

    def _approach(self, x: float, y: float, altitude_m: float, yaw: float | None) -> None:
        """Turn to the goal, drive there, and turn to its yaw."""
        if self.type == mavlink.MAV_TYPE_QUADROTOR:
            self.altitude_m += max(-0.05, min(0.05, altitude_m - self.altitude_m))
        way = math.dist(self.pose[:2], (x, y))
        wanted = yaw if way < 0.02 else math.atan2(y - self.pose[1], x - self.pose[0])
        left = 0.0 if wanted is None else math.remainder(wanted - self.pose[2], math.tau)
        rate = max(-2.0, min(2.0, left / TICK_S))
        is_ahead = way >= 0.02 and abs(left) < 0.05
        self.twist = (min(self.speed_m_s, way / TICK_S) if is_ahead else 0.0), rate


class Px4Vehicle(Vehicle):
    """A vehicle with PX4.

    It switches to OFFBOARD only while set-points arrive, and leaves it for LOITER when they cease. The altitude of a
    take-off command is above the sea.

    Attributes:
        loss_s: PX4's COM_OF_LOSS_T.
    """

    autopilot = mavlink.MAV_AUTOPILOT_PX4
    OFFBOARD = 6 << 16
    LOITER = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    SEA_M = 488.0

    def __init__(self, wire: int | Any, kind: str = "rover", loss_s: float = 5.0) -> None:
        super().__init__(wire, kind)
        self._guided, self._hold, self.mode = self.OFFBOARD, self.LOITER, self.LOITER
        self.loss_s = loss_s
        self._streamed_s = -math.inf
        self.streamed = 0

    def _take(self, message: Any, now_s: float) -> None:
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            self._streamed_s, self.streamed = now_s, self.streamed + 1
        super()._take(message, now_s)

    def set_mode(self, mode: int, sub_mode: int) -> int:
        wanted = mode << 16 | sub_mode << 24
        if wanted == self.OFFBOARD and REAL_TIME.now() - self._streamed_s > self.loss_s:
            return int(mavlink.MAV_RESULT_DENIED)
        self.mode = wanted
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def takeoff_m(self, parameter_m: float) -> float:
        return max(0.0, parameter_m - self.SEA_M)

    def _move(self, now_s: float) -> None:
        if self.mode == self.OFFBOARD and now_s - self._streamed_s > self.loss_s:
            self.mode = self.LOITER
        super()._move(now_s)
