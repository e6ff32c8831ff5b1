"""What the base's micro-controller does: leases, tags and the watchdog. It reads no clock and knows no wire."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Mapping
from typing import Final

from .messages import (
    CHANNELS,
    MAX_NUMBER,
    TAGS,
    VERSION,
    WATCHDOG_MS,
    Channel,
    Code,
    Reply,
    Request,
    State,
    Verb,
    Welcome,
    is_newer,
)
from .wheels import Actuator, WheelModel

_ROUNDING_S: Final = 1e-9


class Firmware:
    """Carries out requests, each order once, and stops everything when it hears nothing fresh.

    Args:
        model: 2 for the EvBot II, 3 for the EvBot III.
        wheels: of the make, for the greeting.
        actuators: by channel.
        senses: returns the numbers that the status has behind those of the actuators.
        boot: another number each time it is switched on, 1..65535; the first lease follows from it.

    Attributes:
        executed: how many orders were carried out.

    Thread: its owner's; none of it blocks.
    """

    def __init__(
        self,
        model: int,
        wheels: WheelModel,
        actuators: Mapping[Channel, Actuator],
        boot: int,
        senses: Callable[[], tuple[int, ...]] = tuple,
    ) -> None:
        self.executed = 0
        self._model = model
        self._wheels = wheels
        self._actuators = actuators
        self._senses = senses
        self._boot = boot
        self._lease = boot
        self._is_leased = False
        self._host = 0
        self._watchdog_s = 0.0
        self._heard_s = -math.inf
        self._polled = 0
        self._tags = dict.fromkeys(actuators, 0)
        self._replies: dict[Channel, tuple[Verb, Code]] = {}

    @property
    def is_busy(self) -> bool:
        """Whether something moves, so that `tick` must be called again and again."""
        return any(actuator.is_busy for actuator in self._actuators.values())

    def tick(self, now_s: float) -> None:
        """Look after what moves; stop it when the watchdog time has passed in silence."""
        if self._is_leased and now_s - self._heard_s > self._watchdog_s + _ROUNDING_S:
            self._end_lease(State.SILENT)
        for actuator in self._actuators.values():
            actuator.tick(now_s)

    def handle(self, request: Request, now_s: float) -> Reply:
        """Carry out a request and return the reply to it."""
        self.tick(now_s)
        if request.verb is Verb.HELLO:
            code = self._greet(request.numbers, now_s)
            return self._reply(request, code, self._welcome() if code is Code.OK else ())
        if not self._is_leased or request.lease != self._lease:
            return self._reply(request, Code.LEASE)
        if request.verb is Verb.STAT:
            if is_newer(request.tag, self._polled):
                self._polled, self._heard_s = request.tag, now_s
            return self._reply(request, Code.OK, self._status(now_s))
        if request.verb is Verb.BYE:
            self._end_lease(State.STOPPED)
            return self._reply(request, Code.OK)
        channel = CHANNELS.get(request.verb)
        if channel is None or channel not in self._actuators:
            return self._reply(request, Code.VERB)
        code = self._order(channel, request, now_s)
        return self._reply(request, code, self._status(now_s) if code is Code.OK else ())

    def _end_lease(self, state: State) -> None:
        self._is_leased = False
        for actuator in self._actuators.values():
            actuator.stop(state)

    def _order(self, channel: Channel, request: Request, now_s: float) -> Code:
        if request.tag == self._tags[channel] and channel in self._replies:
            verb, code = self._replies[channel]
            return code if verb is request.verb else Code.OLD
        if not is_newer(request.tag, self._tags[channel]):
            return Code.OLD
        self._tags[channel], self._heard_s = request.tag, now_s
        code = self._actuators[channel].accept(request.verb, request.numbers, request.tag, now_s)
        self._replies[channel] = request.verb, code
        self.executed += code is Code.OK
        return code

    def _greet(self, numbers: tuple[int, ...], now_s: float) -> Code:
        version, watchdog_ms, host = numbers
        if version != VERSION:
            return Code.VERSION
        if not WATCHDOG_MS[0] <= watchdog_ms <= WATCHDOG_MS[1]:
            return Code.RANGE
        if self._is_leased:
            return Code.OK if host == self._host else Code.BUSY
        self._lease = self._lease % (TAGS - 1) + 1
        self._is_leased, self._host, self._heard_s = True, host, now_s
        self._watchdog_s = watchdog_ms / 1000
        return Code.OK

    def _welcome(self) -> tuple[int, ...]:
        step_um, speed_um_s = (round(value * 1e6) for value in (self._wheels.step_m, self._wheels.max_speed_m_s))
        welcome = Welcome(self._model, VERSION, self._boot, self._lease, step_um, speed_um_s)
        return (*welcome, self._polled, *self._tags.values())

    def _status(self, now_s: float) -> tuple[int, ...]:
        numbers = [number for actuator in self._actuators.values() for number in actuator.status()]
        numbers[0] = int(now_s * 1000) % (MAX_NUMBER + 1)
        return (*numbers, *self._senses())

    @staticmethod
    def _reply(request: Request, code: Code, numbers: tuple[int, ...] = ()) -> Reply:
        return Reply(request.verb, request.tag, code, numbers)


def any_boot() -> int:
    """Return a number for `boot` that is hardly the one before: what a micro-controller makes of noise."""
    return secrets.randbelow(TAGS - 1) + 1
