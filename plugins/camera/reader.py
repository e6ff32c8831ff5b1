"""The thread that opens a source and reads from it, so that the newest picture is always at hand.

It alone touches the capture. Whoever wants a picture waits for one whose reading began after the call: one that was
under way at the call may show what was before it. Reading, retries and time-outs are in real seconds, because a camera
is real hardware whatever the fleet's clock does.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np

from eal_actors.plugin import ArgumentError, Clock, NotReadyError, UnavailableError, get_logger

from .capture import Capture, Image, real_s

_T = TypeVar("_T")

_FIRST_TRY_S: Final = 0.2
_LONGEST_TRY_S: Final = 5.0
_JOIN_S: Final = 3.0
_STEP_S: Final = 0.02
_PAUSE_S: Final = 0.001  # of the fleet's clock, in which other calls are answered
_PERIODS: Final = 2  # that may pass in vain before the patience begins: the one under way at a call, and the next
_SIZE_PX: Final = (16, 4096)
_SAMPLE: Final = 16  # rows and columns from one looked-at pixel to the next, before a picture is compared whole


@dataclass(frozen=True)
class Frame:
    """A picture as it came.

    Attributes:
        number: of the reading, counted from 1.
        image: the picture; nobody writes to it.
        stamp_s: when it had come, in seconds of the fleet's clock.
    """

    number: int
    image: Image
    stamp_s: float


@dataclass(eq=False)
class _Wish:
    """What somebody wants of the source, and what became of it."""

    values: Mapping[str, float]
    refused: list[str] | None = None


@dataclass(frozen=True)
class Terms:
    """How a source is to be read.

    Attributes:
        name: what messages call the source.
        patience_s: seconds without a picture that are borne, and two periods of the source: real ones of the source,
            and those of the fleet's clock of a caller who waits.
        frozen_after_s: real seconds of the same picture after which the source counts as frozen; None for never.
        wishes: what to ask of the source each time that it is opened: width, height, fps, exposure.
        place: what log lines say besides.
    """

    name: str
    patience_s: float
    frozen_after_s: float | None = None
    wishes: Mapping[str, float] = field(default_factory=dict)
    place: Mapping[str, str] = field(default_factory=dict)


class Reader:
    """See the module.

    Args:
        open_capture: opens the source, or raises OSError while it is absent. It may take long, or even hang.
        terms: how to read it.
        clock: the fleet's clock, for time stamps and for how long callers wait.

    Thread: any, where a method says nothing else.
    """

    def __init__(self, open_capture: Callable[[], Capture], terms: Terms, clock: Clock) -> None:
        self._open_capture = open_capture
        self._terms = terms
        self._clock = clock
        self._wishes = dict(terms.wishes)
        self._log = get_logger(**terms.place)
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"reading {terms.name}", daemon=True)
        self._is_stopping = False
        self._is_open = False
        self._frame: Frame | None = None
        self._begun = 0
        self._mode: dict[str, float] = {}
        self._pending: deque[_Wish] = deque()
        self._trouble: str | None = None
        self._next_try_s: float | None = None
        self._sign_s = self._other_s = real_s()
        self._delay_s = _FIRST_TRY_S

    # For its users.

    def start(self) -> None:
        """Begin to open the source; does not wait for it."""
        self._sign_s = real_s()
        self._thread.start()  # not by the fleet's clock, in which it takes no part

    def close(self) -> None:
        """Let go of the source. Thread: blocks the caller, for three real seconds at most."""
        with self._changed:
            self._is_stopping = True
            self._changed.notify_all()
        with self._clock.outside():
            self._thread.join(_JOIN_S)
        if self._thread.is_alive():
            self._log.error(
                "the camera's source hangs; it is abandoned, and stays in use until it answers",
                source=self._terms.name,
            )

    def why_not_ready(self) -> str | None:
        """Return why no picture can be had now, or None. Does not wait."""
        with self._changed:
            return self._why_not_ready()

    def newer(self) -> Generator[float, None, Frame]:
        """Wait for a picture whose reading began after this call.

        Raises:
            NotReadyError: the source is lost, frozen, or at its end.
            UnavailableError: none came in time, though nothing is known to be wrong.

        Returns:
            An activity that gives the picture; it notes the call at its first step.
        """
        after = self._begun
        return (yield from self._await(lambda: self._frame_after(after), "has delivered no newer picture"))

    def mode(self) -> Generator[float, None, dict[str, float]]:
        """Tell what the source gives: width, height, fps, exposure; a key is left out where that is not known.

        Raises:
            NotReadyError: see `newer`.
            UnavailableError: see `newer`.

        Returns:
            An activity that waits until the first picture has come.
        """
        yield from self._await(lambda: self._frame, "has delivered no picture")
        return dict(self._mode)

    def adjust(self, wishes: Mapping[str, float]) -> Generator[float, None, None]:
        """Ask something of the source, now and each time that it is opened anew.

        Args:
            wishes: some of width, height, fps, exposure.

        Raises:
            ArgumentError: the source refused it; what there is instead.
            NotReadyError: see `newer`.
            UnavailableError: see `newer`.

        Returns:
            An activity that waits until the source has answered. One that is closed before withdraws the wish.
        """
        wish = _Wish(wishes)
        with self._changed:
            self._pending.append(wish)
            self._changed.notify_all()
        try:
            refused = yield from self._await(lambda: wish.refused, "has not said whether it can do so")
        finally:
            with contextlib.suppress(ValueError), self._changed:  # usually it has been granted or refused
                self._pending.remove(wish)
        if refused:
            raise ArgumentError(f"{self._terms.name}: {'; '.join(refused)}")

    def _frame_after(self, number: int) -> Frame | None:
        return self._frame if self._frame is not None and self._frame.number > number else None

    def _await(self, look: Callable[[], _T | None], lacks: str) -> Generator[float, None, _T]:
        """Wait for what a look finds, in short waits of real time, so that a clock in lock step does not jump over it.

        Thread: each step blocks the caller for a fiftieth of a second at most.
        """
        begun_s = real_s()
        limit_s = self._terms.patience_s / self._clock.of_real(1.0) + self._periods_s()
        while True:
            with self._changed:
                if look() is None and self._why_not_ready() is None:
                    self._changed.wait(_STEP_S)
                if (found := look()) is not None:
                    return found
                if (reason := self._why_not_ready()) is not None:
                    raise NotReadyError(reason)
            if real_s() - begun_s >= limit_s:
                raise UnavailableError(
                    f"{self._terms.name} {lacks} within {self._terms.patience_s:g} s of the fleet's clock"
                )
            yield _PAUSE_S

    def _why_not_ready(self) -> str | None:
        """See `why_not_ready`. Thread: holds the lock."""
        now_s, name = real_s(), self._terms.name
        if self._is_stopping:
            return f"{name} is closed"
        if self._trouble is not None:
            again = f"; next try in {max(self._next_try_s - now_s, 0.0):.1f} s" if self._next_try_s is not None else ""
            return f"{name}: {self._trouble}{again}"
        if (silent_s := now_s - self._sign_s) > self._patience_s():
            what = "is frozen: no picture" if self._is_open else "has not opened, nor failed to,"
            return f"{name} {what} for {silent_s:.1f} s"
        limit_s = self._terms.frozen_after_s
        if limit_s is not None and self._sign_s - self._other_s > limit_s:
            return f"{name} is frozen: the same picture, to the last bit, for {self._sign_s - self._other_s:.1f} s"
        return None

    def _periods_s(self) -> float:
        return _PERIODS / self._mode["fps"] if "fps" in self._mode else 0.0

    def _patience_s(self) -> float:
        return self._terms.patience_s + self._periods_s()

    # The thread.

    def _run(self) -> None:
        while not self._is_stopping:
            try:
                self._read_until_lost()
            except EOFError as end:
                self._note_trouble(str(end), None)
                return
            except Exception as error:  # noqa: BLE001  # whatever a backend raises, the source may come back
                reason = str(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
                self._note_trouble(reason, real_s() + self._delay_s)
                self._sleep(self._delay_s, lambda: False)
                self._delay_s = min(2 * self._delay_s, _LONGEST_TRY_S)

    def _read_until_lost(self) -> None:
        capture = self._open_capture()
        try:
            self._take_over(capture)
            due_s = real_s()
            while not self._is_stopping:
                self._grant_wishes(capture)
                if capture.period_s is not None and (left_s := due_s - real_s()) > 0:
                    self._sleep(left_s, lambda: bool(self._pending))
                    continue
                due_s = max(due_s + (capture.period_s or 0.0), real_s())
                with self._changed:
                    self._begun += 1
                self._publish(capture.read())
        finally:
            self._is_open = False
            capture.release()

    def _take_over(self, capture: Capture) -> None:
        """Ask the newly opened source for what is wanted."""
        refused = capture.adjust(self._wishes)
        if refused:
            self._log.warning("the camera refuses what is wanted of it", source=self._terms.name, refused=refused)
        mode = capture.mode()
        with self._changed:
            self._mode, self._is_open = mode, True
            self._sign_s = self._other_s = real_s()

    def _grant_wishes(self, capture: Capture) -> None:
        while self._pending:
            with self._changed:
                wish = self._pending.popleft() if self._pending else None
            if wish is None:
                return
            refused = capture.adjust(wish.values)
            mode = capture.mode()
            with self._changed:
                if not refused:
                    self._wishes.update(wish.values)
                self._mode.update(mode)
                wish.refused = refused
                self._sign_s = self._other_s = real_s()
                self._changed.notify_all()

    def _publish(self, image: Image) -> None:
        height, width = image.shape[:2]
        least, most = _SIZE_PX
        if not (least <= width <= most and least <= height <= most):
            raise OSError(f"its pictures are of {width} x {height} px, beyond {least} to {most} px")
        same = self._frame is not None and self._terms.frozen_after_s is not None and is_same(self._frame.image, image)
        with self._changed:
            self._trouble = self._next_try_s = None
            self._delay_s = _FIRST_TRY_S
            self._sign_s = real_s()
            if not same:
                self._other_s = self._sign_s
            self._mode.update(width=width, height=height)
            self._frame = Frame(self._begun, image, self._clock.now())
            self._changed.notify_all()

    def _note_trouble(self, reason: str, next_try_s: float | None) -> None:
        with self._changed:
            self._trouble, self._next_try_s = reason, next_try_s
            self._changed.notify_all()

    def _sleep(self, duration_s: float, unless: Callable[[], bool]) -> None:
        """Wait in real time, but not on when it is to stop, or when there is something else to do."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_stopping or unless(), duration_s)


def is_same(one: Image, other: Image) -> bool:
    """Tell whether two pictures are equal to the last bit. Most that are not differ in the first few pixels."""
    few = slice(None, None, _SAMPLE)
    return np.array_equal(one[few, few], other[few, few]) and np.array_equal(one, other)
