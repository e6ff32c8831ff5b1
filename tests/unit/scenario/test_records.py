"""Which values of variables go into a record, and come back as they were."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from eal_actors.device.data import EALData
from eal_actors.scenario.report.records import from_record, is_recordable, to_record, to_view

NOT_JSON: list[Any] = [
    10**6000,
    {1: "a"},
    {"a": {1, 2}},
    {"eal_data": 3},
    {"eal_float": "NaN"},
    [object()],
    b"raw",
]


def strictly(record: Any) -> Any:
    """Write a record as JSON and read it as a reader does that knows the standard alone."""
    return json.loads(json.dumps(record, allow_nan=False))


@pytest.mark.parametrize("value", [None, True, 3, 0.5, "text", [1, [2.0, "x"]], {"a": None, "b": [1]}])
def test_plain_values_come_back(value: Any) -> None:
    assert is_recordable(value)
    assert from_record(to_record(value)) == value


def test_readings_come_back_as_readings() -> None:
    back = from_record(to_record(EALData.of(np.array([1.0, 2.5]))))
    assert isinstance(back, EALData)
    assert list(back.value) == [1.0, 2.5]


@pytest.mark.parametrize("value", [math.inf, [1.0, -math.inf], {"a": [math.inf]}])
def test_numbers_that_json_has_no_form_for_come_back(value: Any) -> None:
    assert is_recordable(value)
    assert from_record(strictly(to_record(value))) == value


def test_a_reading_that_is_no_number_comes_back() -> None:
    back = from_record(strictly(to_record(EALData.of(np.array([math.nan, 2.5])))))
    assert math.isnan(back.value[0])
    assert back.value[1] == 2.5


def test_what_people_are_told() -> None:
    assert to_view(EALData.of(np.array([math.nan, 2.5]))) == ["NaN", 2.5]
    assert to_view([math.inf, -math.inf]) == ["Infinity", "-Infinity"]
    assert to_view(object()) is None


@pytest.mark.parametrize("value", NOT_JSON, ids=lambda value: type(value).__name__)
def test_what_would_not_come_back_is_not_kept(value: Any) -> None:
    assert not is_recordable(value)
