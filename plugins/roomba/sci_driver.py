"""The driver of a Roomba 4xx, over its Serial Command Interface."""

from __future__ import annotations

import math
from collections.abc import Generator
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from eal_actors.plugin import Clock, DataError

from . import sci
from .driver import RoombaDriver
from .groups import Contacts, Controls, PowerGroup, Sensors
from .link import RoombaLink
from .listening import LOOK_S, READING_LASTS_S, until
from .motion import slowed
from .predicted_wheels import Travel
from .reading import WheelCommand
from .replies import Reply, ReplyReader, ReplyState
from .sci import CLOCKWISE, COUNTER_CLOCKWISE, MAX_RADIUS_MM, STRAIGHT, WHEELBASE_M, Mode, Op
from .travel import TravelJudge

_LIMITS: Final = (0.2, 0.05, 0.03)  # in s: of the first reply, of any reply, and of a silence within one
_LOSSY_LIMITS: Final = (0.1, 0.03, 0.1, 2.5)  # the last in usual delays
_DELAY_S: Final = 0.02  # of a command
_LOSSY_DELAY_S: Final = 0.03
_PERIOD_IN_MOTION_S: Final = 0.04
_LOSSY_PERIOD_IN_MOTION_S: Final = 0.1  # so that counts tell which requests were lost
_POLL_IN_MOTION_S: Final = 0.05  # of what does not reset the counts
_EARLY: Final = 0.9  # share of the period after which a poll counts as due
_REREAD_S: Final = 0.05  # until a reading in doubt is repeated; the wheels have turned measurably by then
_ALL, _CONTACTS, _CONTROLS, _POWER = 0, 1, 2, 3  # sensor groups
_TRAVEL: Final = (_ALL, _CONTROLS)  # groups whose reply resets the counts
_POWER_PERIOD_S: Final = 2.0
_MANY_BYTES: Final = 20  # a damaged request was one of all sensors, which resets the counts
_PROMPT_S: Final = 0.04  # a line with a longer delay is asked for all sensors at once


class SciDriver(RoombaDriver):
    """Drives a Roomba 4xx: it is polled, and each reading resets its counts of travel."""

    ways = MappingProxyType(
        {
            Mode.OFF: (Op.START, Mode.PASSIVE),
            Mode.PASSIVE: (Op.CONTROL, Mode.SAFE),
            Mode.SAFE: (Op.FULL, Mode.FULL),
        }
    )
    count_m = 0.001
    stop_data = sci.drive(0, COUNTER_CLOCKWISE)
    """No byte that is lost, doubled or inserted makes it a drive; a flipped bit of the speed can."""

    def __init__(self, link: RoombaLink, clock: Clock, mode: Mode, poll_hz: float, name: str) -> None:
        super().__init__(link, clock, mode, poll_hz, name, WHEELBASE_M)
        limits, delay_s = (_LOSSY_LIMITS, _LOSSY_DELAY_S) if self.has_checksums else (_LIMITS, _DELAY_S)
        self._motion_period_s = _LOSSY_PERIOD_IN_MOTION_S if self.has_checksums else _PERIOD_IN_MOTION_S
        self._replies = ReplyReader(*limits)
        self._judge = TravelJudge(delay_s, is_checked=self.has_checksums)
        self._fault: str | None = None
        self._power: PowerGroup | None = None
        self._unusual: PowerGroup | None = None
        self._lost_count = 0
        self._contacts, self._contacts_s = Contacts(), -math.inf
        self._travel_s = self._power_s = -math.inf

    @override
    def wheels(self, left_mm_s: int, right_mm_s: int) -> WheelCommand:
        if (left_mm_s < 0) == (right_mm_s < 0):  # no radius that Drive knows is as near to straight as two wheels are
            return self._drive(round((left_mm_s + right_mm_s) / 2), STRAIGHT)
        in_place = COUNTER_CLOCKWISE if right_mm_s > 0 else CLOCKWISE
        return self._drive(round(abs(right_mm_s - left_mm_s) / 2), in_place)

    @override
    def twist(self, speed_m_s: float, turn_rate_rad_s: float) -> WheelCommand:
        return self._drive(*twist_drive(speed_m_s, turn_rate_rad_s, self.calibration.track_factor))

    @staticmethod
    def _drive(velocity_mm_s: int, radius_mm: int) -> WheelCommand:
        left_m_s, right_m_s = sci.wheel_speeds_m_s(velocity_mm_s, radius_mm)
        return WheelCommand(sci.drive(velocity_mm_s, radius_mm), left_m_s, right_m_s)

    @property
    @override
    def interruption(self) -> str | None:
        return self._fault

    @property
    @override
    def travel_doubt(self) -> Travel:
        return self._judge.doubt

    @property
    @override
    def delay_s(self) -> float:
        return self._replies.delay_s

    @property
    @override
    def _longest_period_s(self) -> float:
        """A lost reply loses its travel, so replies must be frequent while the wheels turn."""
        moves = any(self._commanded_m_s) or self._must_stand
        return min(self._motion_period_s, _POLL_IN_MOTION_S) if moves else math.inf

    @override
    def _note_wheels(self, left_m_s: float, right_m_s: float) -> None:
        super()._note_wheels(left_m_s, right_m_s)
        self._judge.command((left_m_s, right_m_s), self.clock.now())

    def _stop(self) -> None:
        super()._stop()
        self._fault = None

    def _poll_once(self) -> Generator[float, None, bool]:
        """Take a reading; while the wheels turn, their travel alone, because a short reply is lost less often."""
        now_s, reading = self.clock.now(), self._reading
        stands, is_slow = self._longest_period_s == math.inf, self.delay_s > _PROMPT_S
        if stands or is_slow or reading is None or now_s - reading.stamp_s > self._lasts_s:
            return (yield from self._exchange(_ALL))
        if now_s - self._power_s > _POWER_PERIOD_S:
            yield from self._exchange(_POWER)
        is_good = False
        if self.is_due(self._contacts_s + _EARLY * self._motion_period_s / 2):
            is_good = yield from self._exchange(_CONTACTS)
        if self.is_due(self._travel_s + _EARLY * self._motion_period_s):
            is_good = yield from self._exchange(_CONTROLS)
        return is_good

    def _exchange(self, group: int) -> Generator[float, None, bool]:
        """Ask for a group, and wait for the reply; return whether it is good. One in doubt is asked for again soon."""
        yield from until(lambda: self._ask(group))
        is_good = False
        while True:
            with self._lock:
                now_s = self.clock.now()
                self._replies.feed(self._link.receive(), now_s)
                state = self._replies.state(now_s)
                if state is ReplyState.WHOLE:
                    is_good = self._take_replies()
                elif state is not ReplyState.AWAITED and not is_good:
                    self._next_poll_s = now_s
                    self._lose_reply(state)
                    return False
                if (is_good or state is ReplyState.WHOLE) and not self._replies.awaits_others(now_s):
                    return is_good
            yield LOOK_S

    def _ask(self, group: int) -> float | None:
        with self._lock:
            if not self.is_due(self._quiet_until_s):
                return self._quiet_until_s - self.clock.now()
            now_s = self.clock.now()
            self._take_bytes(self._link.receive())  # a late reply contains travel too
            self._note_delay()
            self._link.ask(sci.ask_sensors(group))
            self._replies.ask(group, now_s)
            if group in _TRAVEL:
                self._travel_s = now_s
                self._judge.ask(now_s)
            return None

    def _take_bytes(self, data: bytes) -> None:
        """Take bytes that come between two polls. Thread: holds the lock."""
        now_s = self.clock.now()
        self._replies.feed(data, now_s)
        if (state := self._replies.state(now_s)) is ReplyState.WHOLE:
            self._take_replies()
        elif state is ReplyState.DAMAGED:
            self._lose_reply(state)

    def _lose_reply(self, state: ReplyState) -> None:
        group, size = self._replies.latest.group, self._replies.held
        self._replies.give_up(state)
        if state is ReplyState.DAMAGED:
            self._log.debug("a reply is dropped", reason="bytes are missing, or too many")
            if group in _TRAVEL:
                self._judge.lose()
            elif size > _MANY_BYTES:
                self._judge.ask(self._replies.latest.asked_s)
            return
        self._lost_count += 1
        if self.has_checksums and group in _TRAVEL:
            self._travel_s = -math.inf  # a count soon after tells whether this request was lost, or its reply
        self._must_repeat |= self._lost_count > 1
        if not self.has_checksums and group in _TRAVEL:  # a cable does not lose whole replies: it was not asked
            self._judge.withdraw()

    def _take_replies(self) -> bool:
        """Take whole replies; return whether the last one is believed. Thread: holds the lock."""
        is_good, self._lost_count = False, 0
        for reply in self._replies.take():
            try:
                is_good = self._take_reply(reply)
            except DataError as error:  # noise on the line
                self._log.debug("a reply is dropped", reason=error.message)
                if reply.group in _TRAVEL:
                    self._judge.lose()
                is_good = False
        if not is_good:
            self._next_poll_s = self.clock.now() + _REREAD_S
        return is_good

    def _take_reply(self, reply: Reply) -> bool:
        """Take a reply if it is plausible; return whether it is.

        Raises:
            DataError: no Roomba sends this.
        """
        self._note_delay()
        if reply.group == _CONTACTS:
            self._contacts, self._contacts_s = Contacts.decode(reply.data), reply.asked_s
            return True
        if reply.group == _CONTROLS:
            return self._take_controls(Controls.decode(reply.data), reply)
        if reply.group == _POWER:
            self._take_power(PowerGroup.decode(reply.data), reply)
            return True
        sensors = Sensors.decode(reply.data)
        self._take_power(sensors.power, reply)
        self._contacts, self._contacts_s = sensors.contacts, reply.asked_s
        return self._take_controls(sensors.controls, reply)

    def _note_delay(self) -> None:
        """Note by how much the latest commands may have come late."""
        since_s, until_s = self._link.unsure_s
        self._judge.model.delay(since_s, min(until_s, self.clock.now()), has_come=until_s < math.inf)

    def _take_power(self, power: PowerGroup, reply: Reply) -> None:
        """Take what a reply says of the battery; a sudden change must be said twice.

        Raises:
            DataError: no battery of a Roomba is so, or changes so.
        """
        power.check()
        if self._power is not None and not power.follows(self._power):
            before, self._unusual = self._unusual, power
            if before is None or not power.follows(before):
                raise DataError("SCI: the battery cannot have changed so")
        self._power, self._power_s, self._unusual = power, reply.asked_s, None

    def _take_controls(self, controls: Controls, reply: Reply) -> bool:
        """Take buttons and travel if they are plausible; return whether they are."""
        if self._reading is None:  # counts from before the first reading are not ours
            self._judge.begin(reply.asked_s)
        else:
            counted = Travel(controls.distance_mm / 1000, controls.angle_mm / 1000)
            judgement = self._judge.answer(reply.asked_s, reply.jitter_s, counted)
            if judgement.is_suspect:
                self._must_repeat = True
                return False
            if judgement.is_false and any(self._commanded_m_s):
                self._fault = (
                    "two readings in a row cannot be true: the line is noisy or late, or the wheels do not obey"
                )
            self._add_travel(*judgement.travel.wheels_m)
        has_turned = bool(controls.distance_mm or controls.angle_mm)
        if self._power is not None and reply.asked_s - self._contacts_s <= READING_LASTS_S:
            self._take(self._reading_of(reply.asked_s, self._contacts, self._power, controls.pressed, has_turned))
        return True


def twist_drive(speed_m_s: float, turn_rate_rad_s: float, track_factor: float = 1.0) -> tuple[int, int]:
    """Return Drive's velocity in mm/s and radius in mm for a twist, positive forward and counter-clockwise.

    A radius beyond 2 m is taken as 2 m or as straight, whichever is the nearer curve. `track_factor` is the effective
    over the nominal distance of the wheels.
    """
    speed_m_s, turn_rate_rad_s = slowed(speed_m_s, turn_rate_rad_s, WHEELBASE_M * track_factor)
    turn_rate_rad_s *= track_factor
    velocity_mm_s = round(speed_m_s * 1000)
    if abs(turn_rate_rad_s) * 2 * MAX_RADIUS_MM < abs(speed_m_s) * 1000:
        return velocity_mm_s, STRAIGHT
    radius_mm = speed_m_s / turn_rate_rad_s * 1000 if turn_rate_rad_s else 0.0
    if abs(radius_mm) < 1.5:  # 1 and -1 mean in place
        in_place = COUNTER_CLOCKWISE if turn_rate_rad_s > 0 else CLOCKWISE
        return round(abs(turn_rate_rad_s) * WHEELBASE_M / 2 * 1000), in_place
    return velocity_mm_s, round(max(-MAX_RADIUS_MM, min(MAX_RADIUS_MM, radius_mm)))
