"""The thread that opens a source and keeps the newest picture.

Only this thread uses the capture. A caller gets a picture whose reading began after the call, because an earlier one
may show the past. Reading, retries and time-outs are in real seconds: a camera is independent of the fleet's clock.
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
_PAUSE_S: Final = 0.001  # of the fleet's clock; other calls are answered meanwhile
_PERIODS: Final = 2  # without a picture before the time-out begins: the period of the call, and the next
_SIZE_PX: Final = (16, 4096)
_SAMPLE: Final = 16  # pixel distance of the first, sparse comparison of two pictures


@dataclass(frozen=True)
class Picture:
    """A picture with its number and time.

    Attributes:
        number: of the reading, counted from 1.
        image: the picture; read-only.
        stamp_s: time of arrival, in seconds of the fleet's clock.
    """

    number: int
    image: Image
    stamp_s: float


@dataclass(eq=False)
class _PendingChange:
    """A requested change of settings, and its result."""

    values: Mapping[str, float]
    refused: list[str] | None = None


@dataclass(frozen=True)
class ReaderOptions:
    """The options of a reader.

    Attributes:
        name: the source's name in messages.
        patience_s: time-out without a picture, in addition to two periods of the source: in real seconds for the
            source, in seconds of the fleet's clock for a waiting caller.
        frozen_after_s: real seconds of the same picture after which the source counts as frozen; None for never.
        wishes: settings to apply after each opening: width, height, fps, exposure.
        place: additional fields of log lines.
    """

    name: str
    patience_s: float
    frozen_after_s: float | None = None
    wishes: Mapping[str, float] = field(default_factory=dict)
    place: Mapping[str, str] = field(default_factory=dict)


class SourceReader:
    """Reads a source in its own thread; see the module.

    Args:
        open_capture: opens the source, or raises OSError while it is absent. It may block or hang.
        clock: the fleet's clock, for time stamps and time-outs of callers.

    Thread: any, unless a method states another.
    """

    def __init__(self, open_capture: Callable[[], Capture], options: ReaderOptions, clock: Clock) -> None:
        self._open_capture = open_capture
        self._options = options
        self._clock = clock
        self._wishes = dict(options.wishes)
        self._log = get_logger(**options.place)
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"reading {options.name}", daemon=True)
        self._is_stopping = False
        self._is_open = False
        self._frame: Picture | None = None
        self._begun = 0
        self._mode: dict[str, float] = {}
        self._pending: deque[_PendingChange] = deque()
        self._trouble: str | None = None
        self._next_try_s: float | None = None
        self._sign_s = self._other_s = real_s()
        self._delay_s = _FIRST_TRY_S

    def start(self) -> None:
        """Begin to open the source; does not wait for it."""
        self._sign_s = real_s()
        self._thread.start()  # not through the fleet's clock: the thread runs in real time

    def close(self) -> None:
        """Close the source. Thread: blocks the caller for at most three real seconds."""
        with self._changed:
            self._is_stopping = True
            self._changed.notify_all()
        with self._clock.outside():
            self._thread.join(_JOIN_S)
        if self._thread.is_alive():
            self._log.error(
                "the camera's source hangs; it is abandoned and stays in use until it answers",
                source=self._options.name,
            )

    def why_not_ready(self) -> str | None:
        """Return why there is no picture now, or None. Does not block."""
        with self._changed:
            return self._why_not_ready()

    def latest(self) -> Picture:
        """Return the newest picture, which may be as old as the source's period. Does not block.

        Raises:
            NotReadyError: the source is lost, frozen, at its end, or has delivered no picture yet.
        """
        with self._changed:
            reason = self._why_not_ready()
            if reason is None and self._frame is not None:
                return self._frame
        raise NotReadyError(reason or f"{self._options.name} has delivered no picture yet")

    def newer(self) -> Generator[float, None, Picture]:
        """Wait for a picture whose reading began after this call.

        Raises:
            NotReadyError: the source is lost, frozen, or at its end.
            UnavailableError: none arrived in time, for an unknown reason.

        Returns:
            An activity that returns the picture; the call counts from its first step.
        """
        after = self._begun
        return (yield from self._await(lambda: self._frame_after(after), "has delivered no newer picture"))

    def mode(self) -> Generator[float, None, dict[str, float]]:
        """Return the source's width, height, fps and exposure, as far as they are known.

        Raises:
            NotReadyError: see `newer`.
            UnavailableError: see `newer`.

        Returns:
            An activity that waits for the first picture.
        """
        yield from self._await(lambda: self._frame, "has delivered no picture")
        return dict(self._mode)

    def adjust(self, wishes: Mapping[str, float]) -> Generator[float, None, None]:
        """Change settings of the source, now and after each reopening.

        Args:
            wishes: some of width, height, fps, exposure.

        Raises:
            ArgumentError: the source refused; the message states its present settings.
            NotReadyError: see `newer`.
            UnavailableError: see `newer`.

        Returns:
            An activity that waits for the source's answer. Closing it earlier cancels the change.
        """
        wish = _PendingChange(wishes)
        with self._changed:
            self._pending.append(wish)
            self._changed.notify_all()
        try:
            refused = yield from self._await(lambda: wish.refused, "has not answered the change of settings")
        finally:
            with contextlib.suppress(ValueError), self._changed:  # usually it is done already
                self._pending.remove(wish)
        if refused:
            raise ArgumentError(f"{self._options.name}: {'; '.join(refused)}")

    def _frame_after(self, number: int) -> Picture | None:
        return self._frame if self._frame is not None and self._frame.number > number else None

    def _await(self, look: Callable[[], _T | None], lacks: str) -> Generator[float, None, _T]:
        """Poll in short waits of real time, so that a clock in lock step does not skip the result.

        Thread: each step blocks the caller for at most 0.02 s.
        """
        begun_s = real_s()
        limit_s = self._options.patience_s / self._clock.of_real(1.0) + self._periods_s()
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
                    f"{self._options.name} {lacks} within {self._options.patience_s:g} s of the fleet's clock"
                )
            yield _PAUSE_S

    def _why_not_ready(self) -> str | None:
        """Return why there is no picture now, or None. Thread: holds the lock."""
        now_s, name = real_s(), self._options.name
        if self._is_stopping:
            return f"{name} is closed"
        if self._trouble is not None:
            again = f"; next try in {max(self._next_try_s - now_s, 0.0):.1f} s" if self._next_try_s is not None else ""
            return f"{name}: {self._trouble}{again}"
        if (silent_s := now_s - self._sign_s) > self._patience_s():
            what = "is frozen: no picture" if self._is_open else "has neither opened nor failed"
            return f"{name} {what} for {silent_s:.1f} s"
        limit_s = self._options.frozen_after_s
        if limit_s is not None and self._sign_s - self._other_s > limit_s:
            return f"{name} is frozen: an identical picture for {self._sign_s - self._other_s:.1f} s"
        return None

    def _periods_s(self) -> float:
        return _PERIODS / self._mode["fps"] if "fps" in self._mode else 0.0

    def _patience_s(self) -> float:
        return self._options.patience_s + self._periods_s()

    def _run(self) -> None:
        while not self._is_stopping:
            try:
                self._read_until_lost()
            except EOFError as end:
                self._note_trouble(str(end), None)
                return
            except Exception as error:  # noqa: BLE001  # after any exception of a backend, the source may come back
                reason = str(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
                self._note_trouble(reason, real_s() + self._delay_s)
                self._sleep(self._delay_s, lambda: False)
                self._delay_s = min(2 * self._delay_s, _LONGEST_TRY_S)

    def _read_until_lost(self) -> None:
        capture = self._open_capture()
        try:
            self._configure(capture)
            due_s = real_s()
            while not self._is_stopping:
                self._apply_changes(capture)
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

    def _configure(self, capture: Capture) -> None:
        """Apply the settings to the newly opened source."""
        refused = capture.adjust(self._wishes)
        if refused:
            self._log.warning("the camera refuses settings", source=self._options.name, refused=refused)
        mode = capture.mode()
        with self._changed:
            self._mode, self._is_open = mode, True
            self._sign_s = self._other_s = real_s()

    def _apply_changes(self, capture: Capture) -> None:
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
            raise OSError(f"its pictures have {width} x {height} px, outside {least} to {most} px")
        same = (
            self._frame is not None and self._options.frozen_after_s is not None and is_same(self._frame.image, image)
        )
        with self._changed:
            self._trouble = self._next_try_s = None
            self._delay_s = _FIRST_TRY_S
            self._sign_s = real_s()
            if not same:
                self._other_s = self._sign_s
            self._mode.update(width=width, height=height)
            self._frame = Picture(self._begun, image, self._clock.now())
            self._changed.notify_all()

    def _note_trouble(self, reason: str, next_try_s: float | None) -> None:
        with self._changed:
            self._trouble, self._next_try_s = reason, next_try_s
            self._changed.notify_all()

    def _sleep(self, duration_s: float, unless: Callable[[], bool]) -> None:
        """Wait in real time; return early on a stop or if `unless()` is true."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_stopping or unless(), duration_s)


def is_same(one: Image, other: Image) -> bool:
    """Return whether two pictures are identical. A sparse comparison finds most differences first."""
    few = slice(None, None, _SAMPLE)
    return np.array_equal(one[few, few], other[few, few]) and np.array_equal(one, other)
