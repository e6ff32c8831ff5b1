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
        limit: the most it may be.
        unit: the unit of value and limit; empty for a ratio.
    """

    what: str
    ours: str
    reference: str
    value: float
    limit: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether the figure is within its limit."""
        return self.value <= self.limit

    def row(self) -> tuple[str, str, str, str, str, str]:
        """Return the cells of a table."""
        unit = f" {self.unit}" if self.unit else "x"
        verdict = "holds" if self.holds else "MISSED"
        return self.what, self.ours, self.reference, f"{self.value:.2f}{unit}", f"{self.limit:g}{unit}", verdict
