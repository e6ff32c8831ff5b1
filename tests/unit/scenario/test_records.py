"""Which values of variables go into a record, and come back as they were."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from eal_actors.data import EALData
from eal_actors.scenario.records import from_record, is_recordable, to_record

NOT_JSON: list[Any] = [
    float("nan"),
    10**6000,
    {1: "a"},
    {"a": float("inf")},
    {"a": {1, 2}},
    {"eal_data": 3},
    [object()],
    b"raw",
]


@pytest.mark.parametrize("value", [None, True, 3, 0.5, "text", [1, [2.0, "x"]], {"a": None, "b": [1]}])
def test_plain_values_come_back(value: Any) -> None:
    assert is_recordable(value)
    assert from_record(to_record(value)) == value


def test_readings_come_back_as_readings() -> None:
    back = from_record(to_record(EALData.of(np.array([1.0, 2.5]))))
    assert isinstance(back, EALData)
    assert list(back.value) == [1.0, 2.5]


@pytest.mark.parametrize("value", NOT_JSON, ids=lambda value: type(value).__name__)
def test_what_would_not_come_back_is_not_kept(value: Any) -> None:
    assert not is_recordable(value)
