"""The reference firmware of a base: leases, tags and the watchdog; and the emulated base with a codec.

Nothing here reads a clock or blocks: the owner passes bytes and the time. Thread: the owner's.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Mapping
from typing import Any, Final

from .codec import Codec
from .messages import (
    CHANNELS,
    MAX_NUMBER,
    TAGS,
    VERSION,
    WATCHDOG_MS,
    BaseReply,
    BaseRequest,
    BaseWelcome,
    Code,
    InvalidRequest,
    OrderChannel,
    State,
    Verb,
    is_newer,
)
from .wheels import Actuator, WheelModel

_ROUNDING_S: Final = 1e-9


class Firmware:
    """Carries out requests, each order once, and stops everything when it receives nothing new for the watchdog time.

    Args:
        model: 2 for the EvBot II, 3 for the EvBot III.
        wheels: the wheel model, for the greeting.
        senses: returns the numbers of the status after those of the actuators.
        boot: a new number for each power-up, 1..65535; the first lease follows from it.

    Attributes:
        executed: the number of orders carried out.
    """

    def __init__(
        self,
        model: int,
        wheels: WheelModel,
        actuators: Mapping[OrderChannel, Actuator],
        boot: int,
        senses: Callable[[], tuple[int, ...]] = tuple,
    ) -> None:
        self.executed = 0
        self._model, self._wheels, self._boot = model, wheels, boot
        self._actuators, self._senses = actuators, senses
        self._lease = boot
        self._is_leased = False
        self._host = 0
        self._watchdog_s = 0.0
        self._heard_s = -math.inf
        self._polled = 0
        self._tags = dict.fromkeys(actuators, 0)
        self._replies: dict[OrderChannel, tuple[Verb, Code]] = {}

    @property
    def is_busy(self) -> bool:
        """Whether something moves; `tick` must be called repeatedly."""
        return any(actuator.is_busy for actuator in self._actuators.values())

    def tick(self, now_s: float) -> None:
        """Advance all motions; stop them when the watchdog time has passed without a new message."""
        if self._is_leased and now_s - self._heard_s > self._watchdog_s + _ROUNDING_S:
            self._end_lease(State.SILENT)
        for actuator in self._actuators.values():
            actuator.tick(now_s)

    def handle(self, request: BaseRequest, now_s: float) -> BaseReply:
        """Carry out a request and return its reply."""
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

    def _order(self, channel: OrderChannel, request: BaseRequest, now_s: float) -> Code:
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
            if host != self._host:
                return Code.BUSY
            self._watchdog_s = watchdog_ms / 1000
            return Code.OK
        self._lease = self._lease % (TAGS - 1) + 1
        self._is_leased, self._host, self._heard_s = True, host, now_s
        self._watchdog_s = watchdog_ms / 1000
        return Code.OK

    def _welcome(self) -> tuple[int, ...]:
        step_um, speed_um_s = (round(value * 1e6) for value in (self._wheels.step_m, self._wheels.max_speed_m_s))
        welcome = BaseWelcome(self._model, VERSION, self._boot, self._lease, step_um, speed_um_s)
        return (*welcome, self._polled, *self._tags.values())

    def _status(self, now_s: float) -> tuple[int, ...]:
        numbers = [number for actuator in self._actuators.values() for number in actuator.status()]
        numbers[0] = int(now_s * 1000) % (MAX_NUMBER + 1)
        return (*numbers, *self._senses())

    @staticmethod
    def _reply(request: BaseRequest, code: Code, numbers: tuple[int, ...] = ()) -> BaseReply:
        return BaseReply(request.verb, request.tag, code, numbers)


class BaseEmulator:
    """An emulated base: firmware with a codec, bytes in, bytes out.

    Attributes:
        nonsense: the number of intact but invalid requests.
    """

    def __init__(self, firmware: Firmware, codec: Codec[Any, BaseReply]) -> None:
        self.firmware = firmware
        self.nonsense = 0
        self._codec = codec

    @property
    def is_busy(self) -> bool:
        """Whether something moves; `tick` must be called repeatedly."""
        return self.firmware.is_busy

    @property
    def damaged(self) -> int:
        """The number of damaged requests, which are ignored."""
        return self._codec.damaged

    @property
    def complaints(self) -> list[str]:
        """The counts of unreadable requests, for `eal plugin check`."""
        counts = {"damaged": self.damaged, "invalid": self.nonsense}
        return [f"{count} requests {kind}" for kind, count in counts.items() if count]

    def tick(self, now_s: float) -> None:
        """Advance to a time."""
        self.firmware.tick(now_s)

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the wire and return the replies to them.

        Args:
            data: any bytes, in pieces of any size.
            now_s: the time, which never goes backwards.
        """
        return b"".join(self.replies(data, now_s))

    def replies(self, data: bytes, now_s: float) -> list[bytes]:
        """Take bytes and return the replies to them one by one; see `feed`."""
        self.tick(now_s)
        return [self._codec.encode(self._answer(request, now_s)) for request in self._codec.feed(data)]

    def _answer(self, request: BaseRequest | InvalidRequest, now_s: float) -> BaseReply:
        if isinstance(request, InvalidRequest):
            self.nonsense += 1
            return BaseReply(Verb.NONE, request.tag, request.code)
        return self.firmware.handle(request, now_s)


def any_boot() -> int:
    """Return a random `boot` number, as a micro-controller derives it from noise."""
    return secrets.randbelow(TAGS - 1) + 1
