"""Admission: what a robot keeps of the commands that it refuses."""

from __future__ import annotations

import gc
import weakref

import pytest

from eal_actors.kernel.errors import DeadlineError, EALError, ResourceBusyError
from eal_actors.wire.format.messages import CallHeader, CallId
from eal_actors.wire.rpc.server.admission import Admission
from tests.manual_clock import ManualClock

ERA, ANN, BOB = "era", "a" * 32, "b" * 32


class Value(str):
    """An argument, perhaps a large one, to which a weak reference is possible."""


@pytest.mark.parametrize(("deadline_s", "refusal"), [(60.0, ResourceBusyError), (0.0, DeadlineError)])
def test_the_outcome_of_a_refused_command_keeps_none_of_its_arguments(
    deadline_s: float, refusal: type[EALError]
) -> None:
    admission = Admission(ERA, ["Arm"], 1.0, ManualClock(100.0))
    admission.check(CallHeader(ANN, 0, 1, 60.0, 60.0, None, (), ERA, 100.0, 0.0), "set_value", "Arm")
    value = Value()
    kept = weakref.ref(value)
    header = CallHeader(BOB, 0, 1, 60.0, deadline_s, None, (value,), ERA, 100.0, 0.0)
    with pytest.raises(refusal):
        admission.check(header, "set_value", "Arm")
    del value, header
    gc.collect()
    record = admission.recall(CallId(BOB, 0, 1))
    assert record is not None
    assert isinstance(record.outcome, refusal)
    assert kept() is None
