"""ValueInfo: what a value must be: its type, unit, shape and range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from eal_actors.device.data.c_types import NUMERIC_TYPES, DataType
from eal_actors.device.data.texts import info_text, repr_of
from eal_actors.device.data.value import EALData
from eal_actors.kernel.errors import ArgumentError


@dataclass(frozen=True, slots=True)
class ValueInfo:
    """The type, unit and range of a value.

    Attributes:
        type: the data type; FLOAT and DOUBLE accept an integer too.
        unit: the unit's symbol, such as `m`, `deg` or `rad/s`; None for a bare number or text.
        minimum: the least valid value, in the unit; None for no limit.
        maximum: the greatest valid value, in the unit; None for no limit.
        choices: the valid values, if they are few; empty for no such limit.
        shape: the array's shape, with None for any size; () for a single value. A list fills rows.
        description: one line for people.
    """

    type: DataType
    unit: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str | float, ...] = ()
    shape: tuple[int | None, ...] = ()
    description: str = ""

    def check(self, data: EALData, what: str) -> None:
        """Raise ArgumentError, naming `what`, unless the value has the type, shape and range."""
        if problem := self.problem(data):
            raise ArgumentError(f"{what} {problem}")

    def problem(self, data: EALData) -> str | None:
        """Return the error of a value as the end of a sentence that begins with its name, or None."""
        kind, wanted = data.type, self.type
        if kind is not wanted and (wanted is DataType.INT or kind not in NUMERIC_TYPES or wanted not in NUMERIC_TYPES):
            return f"must be {self.describe()}, not {repr_of(data)}"
        if self.shape:
            return self._shape_problem(data)
        value = data.value
        if self.choices and value not in self.choices:
            return f"must be one of {', '.join(map(str, self.choices))}, not {value!r}"
        return self._number_problem(data, value) if wanted in NUMERIC_TYPES else None

    def _number_problem(self, data: EALData, value: Any) -> str | None:
        if not isinstance(value, int | float):
            return f"must be {self.describe()}, not {repr_of(data)}"
        below = self.minimum is not None and not value >= self.minimum
        above = self.maximum is not None and not value <= self.maximum
        return f"must be {self.describe()}, not {value:g}" if below or above or value != value else None  # NaN differs

    def _shape_problem(self, data: EALData) -> str | None:
        shape = data.shape
        if shape is None:
            shape = (len(value),) if isinstance(value := data.value, list | tuple) else ()
            match self.shape:  # a C array has no rows
                case (None, int() as row) if shape and shape[0] % row == 0:
                    shape = shape[0] // row, row
        if shape == self.shape:
            return None
        fits = len(shape) == len(self.shape) and all(
            want is None or want == have for want, have in zip(self.shape, shape, strict=True)
        )
        return None if fits else f"must be {self.describe()}, not of shape {shape}"

    def describe(self) -> str:
        """Return the type, range and unit as text, such as `double 0..360 deg`."""
        return info_text(self)
