"""The travel of the wheels, from counts that a damaged reply may have changed and a lost reply has reset.

The Serial Command Interface has no checksum, and each reading resets its counts. So each count is compared with what
the commands make the wheels travel in that time. A count that does not fit is suspect: the next one decides whether it
was false, and is replaced by the prediction, or true, because the wheels do something else than commanded. Where both
remain possible, or the prediction is uncertain, the difference is added to a bound of the error.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from .predicted_wheels import NOTHING, ROUNDING_M, AccelerationGauge, PredictedWheels, Travel

_MAX_SPEED_M_S: Final = 0.6
_MOST_ACCELERATION_M_S2: Final = 2.0  # of the wheels of any Roomba, with a margin
_JITTER_S: Final = 0.02  # a Roomba counts every 15 ms, a simulated one every 20 ms
_UNCERTAIN: Final = 0.03  # share of a predicted travel
_UNSURE: Final = 0.02  # the same where nothing was counted
_UNKNOWN: Final = 0.6  # share of the effect of another acceleration that a count may show
_UNCOMMANDED: Final = 8.0  # travel that was lost, per travel that was counted, of wheels that should stand
_WORSE: Final = 0.6  # misfit by which an explanation is too unlikely, if no byte can be damaged
_SMOOTHING_S: Final = 0.03
_MOST_REQUESTS: Final = 8


@dataclass(frozen=True, slots=True)
class Judgement:
    """The meaning of a count.

    Attributes:
        travel: to add to the total.
        is_suspect: the count does not fit; read again.
        is_false: this one and the one before do not fit, and the travel is not known.
    """

    travel: Travel
    is_suspect: bool = False
    is_false: bool = False


@dataclass(frozen=True, slots=True)
class Explanation:
    """One explanation of the counts: `misfit` is 1 at the tolerance; `travel` since the latest accepted count."""

    misfit: float
    travel: Travel
    doubt: Travel


@dataclass(frozen=True, slots=True)
class _Suspect:
    asked_s: float
    jitter_s: float
    counted: Travel


class TravelJudge:
    """Judges each count, see the module.

    Args:
        delay_s: by which a command may come late.
        is_checked: whether the line has checksums, so that no command is damaged.

    Attributes:
        doubt: bound of the error of the total travel; it only grows.
    """

    def __init__(self, delay_s: float, *, is_checked: bool = False) -> None:
        self.model = PredictedWheels(delay_s)
        self._is_checked = is_checked
        self.doubt = NOTHING
        self._counted_s = -math.inf
        self._late_s = 0.0
        self._requests: deque[tuple[float, bool]] = deque(maxlen=_MOST_REQUESTS)
        self._suspect: _Suspect | None = None
        self._gauge = AccelerationGauge()

    def command(self, speeds_m_s: tuple[float, float], now_s: float) -> None:
        """Record commanded speeds of the left and the right wheel."""
        self.model.command(speeds_m_s, now_s)
        self._gauge.command(speeds_m_s, now_s)

    def ask(self, now_s: float) -> None:
        """Record a request of the counts."""
        self._requests.append((now_s, False))

    def withdraw(self) -> None:
        """Record that the latest request was not received."""
        if self._requests:
            self._requests.pop()

    def lose(self) -> None:
        """Record that the reply to the latest request is lost, but the request was received, and reset the counts."""
        if self._requests:
            self._requests[-1] = (self._requests[-1][0], True)

    def begin(self, asked_s: float, speeds_m_s: tuple[float, float] = (0.0, 0.0)) -> None:
        """Begin at a time, with speeds of the left and the right wheel; counts until then are not ours."""
        self._accept(asked_s, speeds_m_s)

    def answer(self, asked_s: float, jitter_s: float, counted: Travel) -> Judgement:
        """Judge a count, which may have been taken by `jitter_s` later than usual after its request."""
        fits = self._as_true(asked_s, jitter_s, counted) if self._suspect else []
        since_s = self._suspect.asked_s if self._suspect else self._counted_s
        fits += [self.explain(start_s, asked_s, jitter_s, counted) for start_s in self._starts(since_s, asked_s)]
        best = min(fits, key=lambda fit: fit.misfit)
        if best.misfit > 1.0:
            return self._doubt_it(asked_s, jitter_s, counted)
        most_misfit = min(1.0, best.misfit + _WORSE) if self._is_checked else 1.0
        travels = [fit.travel for fit in fits if fit.misfit <= most_misfit]
        least, most = (Travel(*map(choose, zip(*travels, strict=True))) for choose in (min, max))
        travel = least.plus(most).scaled(0.5)
        self._add_doubt(best.doubt)
        self._add_doubt(most.plus(least, -1.0).scaled(0.5))
        if self._suspect is None and len(fits) == 1:
            self._gauge.add(counted, asked_s, self.model)
        else:
            self._gauge.cancel()
        self._accept(asked_s, self._speeds_m_s(best.travel, self._counted_s, asked_s, jitter_s), jitter_s)
        return Judgement(travel)

    def _speeds_m_s(self, travel: Travel, since_s: float, until_s: float, jitter_s: float = 0.0) -> tuple[float, float]:
        """Return the likely speeds of the wheels at the end of a travel that may have been counted later."""
        prompt, late = (self.model.predict(since_s, until_s + more_s).wheels_m for more_s in (0.0, jitter_s))
        speeds_m_s = self.model.speeds_m_s(until_s)
        left_m_s, right_m_s = (
            speeds_m_s[wheel]
            + (moved_m - sorted((prompt[wheel], moved_m, late[wheel]))[1]) / (until_s - since_s + _SMOOTHING_S)
            for wheel, moved_m in enumerate(travel.wheels_m)
        )
        most_left_m_s, most_right_m_s = (
            self.model.most_m_s(moved_m, until_s - since_s + jitter_s) for moved_m in travel.wheels_m
        )
        return (
            max(-most_left_m_s, min(most_left_m_s, left_m_s)),
            max(-most_right_m_s, min(most_right_m_s, right_m_s)),
        )

    def _starts(self, since_s: float, until_s: float) -> Sequence[float]:
        """Return when the counts may have been reset for the last time before a request."""
        starts = [since_s]
        for time_s, is_reset in self._requests:
            if since_s < time_s < until_s:
                starts = [time_s] if is_reset else [*starts, time_s]
        return starts

    def explain(self, start_s: float, asked_s: float, jitter_s: float, counted: Travel) -> Explanation:
        """Explain a count as that since a start; what is missing before follows from what the count tells."""
        missing = self.model.predict(self._counted_s, start_s)
        misfit = self._misfit(counted, start_s, asked_s, jitter_s)
        if start_s <= self._counted_s:
            return Explanation(misfit, missing.plus(counted), NOTHING)
        likely = [missing, self.model.predict(min(self._counted_s + self._late_s, start_s), start_s)]
        for variant in self.model.variants:
            whole = self.model.predict(self._counted_s, asked_s, variant)
            before = self.model.predict(self._counted_s, start_s, variant)
            since = whole.plus(before, -1.0)
            tolerance = self._tolerance(since, asked_s)
            if all(abs(since[place] - counted[place]) < tolerance[place] for place in (0, 1)):
                likely.append(before)
        if max(map(abs, counted)) < ROUNDING_M and not self._is_checked:
            likely.append(NOTHING)  # it may have stood before, too
        least, most = (Travel(*map(choose, zip(*likely, strict=True))) for choose in (min, max))
        doubt = most.plus(least, -1.0).scaled(0.5).plus(Travel(*(_UNSURE * abs(value) for value in missing)))
        if self._is_checked:
            return Explanation(misfit, least.plus(most).scaled(0.5).plus(counted), doubt)
        predicted = self.model.predict(start_s, asked_s)
        stands = max(map(abs, predicted)) < ROUNDING_M / 2 > max(map(abs, missing))  # a rest of it may be rounded up
        uncommanded = Travel(
            *(
                _UNCOMMANDED * abs(value) if stands or (abs(value) >= ROUNDING_M > 2 * abs(likely_m)) else 0.0
                for value, likely_m in zip(counted, predicted, strict=True)
            )
        )
        doubt = doubt.plus(uncommanded)  # a damaged command has set it going
        return Explanation(misfit, least.plus(most).scaled(0.5).plus(counted), doubt)

    def _unsure(self, missing: Travel, until_s: float) -> Travel:
        """Return the uncertainty of a travel that was predicted up to a time."""
        share = Travel(*(_UNSURE * abs(value) for value in missing))
        return share.plus(self.model.unknown(self._counted_s, until_s))

    def _misfit(self, counted: Travel, start_s: float, asked_s: float, jitter_s: float) -> float:
        predicted, unknown = self.model.predict(start_s, asked_s), self.model.unknown(start_s, asked_s)
        tolerance = self._tolerance(predicted, asked_s).plus(unknown, _UNKNOWN)
        late_s = self._late_s if start_s <= self._counted_s else 0.0
        least, most = self.model.predict(start_s + late_s, asked_s), self.model.predict(start_s, asked_s + jitter_s)
        return max(
            max(min(least[place], most[place]) - counted[place], counted[place] - max(least[place], most[place]))
            / tolerance[place]
            for place in (0, 1)
        )

    def _tolerance(self, predicted: Travel, asked_s: float) -> Travel:
        """Return by how much a count may differ from a prediction whose acceleration is right."""
        speed = Travel.of_wheels(*self.model.speeds_m_s(asked_s))
        ahead_m, arc_m = (
            ROUNDING_M + _UNCERTAIN * abs(predicted[place]) + abs(speed[place]) * _JITTER_S for place in (0, 1)
        )
        return Travel(ahead_m, arc_m)

    def _as_true(self, asked_s: float, jitter_s: float, counted: Travel) -> list[Explanation]:
        """Explain a count and the suspect before it as true: taken late, or of wheels that disobey."""
        suspect, fits = self._suspect, []
        if suspect is None:
            return []
        starts = self._starts(suspect.asked_s, asked_s)
        for first_s in self._starts(self._counted_s, suspect.asked_s):
            if not self._is_within_reach(suspect.counted, suspect.asked_s - first_s + suspect.jitter_s):
                continue
            missing = self.model.predict(self._counted_s, first_s)
            most_m = max(map(abs, missing))
            unknown = Travel(most_m, most_m)  # it may have disobeyed before, too, and turned
            if starts == [suspect.asked_s]:
                both, late_s = suspect.counted.plus(counted), max(jitter_s, suspect.jitter_s)
                fits.append(
                    Explanation(
                        self._misfit(both, first_s, asked_s, late_s), missing.plus(both), self._unsure(missing, first_s)
                    )
                )
            for disobeying in self._disobeying(suspect, first_s):
                for start_s in starts:
                    fit = disobeying.explain(start_s, asked_s, jitter_s, counted)
                    travel = missing.plus(suspect.counted).plus(fit.travel)
                    fits.append(Explanation(fit.misfit, travel, fit.doubt.plus(unknown)))
        return fits

    def _is_within_reach(self, travel: Travel, duration_s: float) -> bool:
        """Return whether the wheels can have travelled so since the latest accepted count, whatever they obey."""
        duration_s += _JITTER_S
        gained_m = _MOST_ACCELERATION_M_S2 * duration_s**2 / 2
        speeds_m_s = self.model.speeds_m_s(self._counted_s)
        return all(
            abs(wheel_m) <= min(abs(speed_m_s) * duration_s + gained_m, _MAX_SPEED_M_S * duration_s) + ROUNDING_M
            for wheel_m, speed_m_s in zip(travel.wheels_m, speeds_m_s, strict=True)
        )

    def _disobeying(self, suspect: _Suspect, first_s: float) -> Iterator[TravelJudge]:
        """Return judges of wheels that had turned as a suspect says, and obey, go on or stop since then."""
        mean_m_s = tuple(wheel_m / (suspect.asked_s - first_s + _SMOOTHING_S) for wheel_m in suspect.counted.wheels_m)
        likely_m_s = self._speeds_m_s(suspect.counted, first_s, suspect.asked_s)
        for left_m_s, right_m_s in {mean_m_s, likely_m_s, self.model.speeds_m_s(suspect.asked_s)}:
            if max(abs(left_m_s), abs(right_m_s)) > _MAX_SPEED_M_S:
                continue
            for target in {self.model.target_m_s, (left_m_s, right_m_s), (0.0, 0.0)}:
                judge = TravelJudge(0.0)
                judge.begin(suspect.asked_s, (left_m_s, right_m_s))
                judge.model.command(target, suspect.asked_s)
                yield judge

    def _doubt_it(self, asked_s: float, jitter_s: float, counted: Travel) -> Judgement:
        """Make a count the suspect; if the one before is suspect too, give up."""
        if self._suspect is None:
            self._suspect = _Suspect(asked_s, jitter_s, counted)
            return Judgement(NOTHING, is_suspect=True)
        both, duration_s = self._suspect.counted.plus(counted), asked_s - self._counted_s
        predicted = self.model.predict(self._counted_s, asked_s)
        is_possible = self._is_within_reach(both, duration_s)
        travel = both if is_possible else predicted
        self._add_doubt(both.plus(predicted, -1.0) if is_possible else predicted)
        self._accept(asked_s, self.model.speeds_m_s(asked_s))
        return Judgement(travel, is_false=True)

    def _accept(self, asked_s: float, speeds_m_s: tuple[float, float], jitter_s: float = 0.0) -> None:
        self._counted_s, self._late_s, self._suspect = asked_s, jitter_s, None
        self.model.restart(asked_s, speeds_m_s)
        self._requests = deque((request for request in self._requests if request[0] > asked_s), _MOST_REQUESTS)

    def _add_doubt(self, doubt: Iterable[float]) -> None:
        ahead_m, arc_m = doubt
        self.doubt = self.doubt.plus(Travel(abs(ahead_m), abs(arc_m)))
