"""One measured figure, and how it is shown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """A figure beside its reference and its limit.

    Attributes:
        what: what was measured.
        ours: our figure, with unit.
        reference: what it is compared with, and that figure.
        value: the ratio, or the figure in the limit's unit.
        limit: the most it may be; the least if `at_least`.
        unit: the unit of value and limit; empty for a ratio.
    """

    what: str
    ours: str
    reference: str
    value: float
    limit: float
    unit: str = ""
    at_least: bool = False

    @property
    def holds(self) -> bool:
        """Whether the figure is within its limit."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def row(self) -> tuple[str, str, str, str, str, str]:
        """Return the cells of a table."""
        unit = self.unit if self.unit.startswith("x") else f" {self.unit}" if self.unit else "x"
        verdict = "holds" if self.holds else "MISSED"
        limit = f"{'at least' if self.at_least else 'at most'} {self.limit:g}{unit}"
        return self.what, self.ours, self.reference, f"{self.value:.2f}{unit}", limit, verdict


@dataclass(frozen=True)
class Skipped:
    """A figure that could not be measured here.

    Attributes:
        what: what was to be measured.
        reason: why not.
    """

    what: str
    reason: str
    holds: bool = True

    def row(self) -> tuple[str, str, str, str, str, str]:
        """Return the cells of a table."""
        return self.what, "not measured", self.reason, "", "", "skipped"
