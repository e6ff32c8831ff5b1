"""One trace from a scenario's step to the handler on the robot, over a real link, as OpenTelemetry's SDK keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from opentelemetry import trace
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from eal_actors import Fleet
from eal_actors.kernel import spans
from eal_actors.kernel.errors import ArgumentError
from eal_actors.operate.tracing import Tracing, exporter_to
from eal_actors.scenario import run_scenario
from tests.net.rig import Rig

SCENARIO = """\
version: 1
name: moves
description: Move an arm, and try what fails.
roles: {arms: {}}
steps:
  - on: arms
    do:
      - set_value: {resource: Arm, value: 0.5}
      - send_cmd: {resource: Arm, cmd: jam}
        on_failure: skip
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    file = tmp_path / "moves.yaml"
    file.write_text(SCENARIO)
    return file


def named(found: Sequence[ReadableSpan], name: str, kind: trace.SpanKind) -> ReadableSpan:
    (span,) = [span for span in found if span.name == name and span.kind is kind]
    return span


def line_of(found: Sequence[ReadableSpan], last: ReadableSpan) -> list[tuple[str, trace.SpanKind]]:
    """Return name and kind of a span and of those above it, from the root on."""
    by_id = {span.context.span_id: span for span in found}
    line = [last]
    while (above := line[0].parent) is not None:
        line.insert(0, by_id[above.span_id])
    return [(span.name, span.kind) for span in line]


INTERNAL, CLIENT, SERVER = trace.SpanKind.INTERNAL, trace.SpanKind.CLIENT, trace.SpanKind.SERVER


def test_one_trace_leads_from_the_step_over_the_network_to_the_handler(fleet: Fleet, scenario: Path) -> None:
    exporter = InMemorySpanExporter()
    with Tracing(exporter, "test"):
        run_scenario(scenario, fleet)
    found = exporter.get_finished_spans()
    assert len({span.context.trace_id for span in found}) == 1
    handler = named(found, "Arm/set_value handler", INTERNAL)
    assert line_of(found, handler) == [
        ("scenario moves", INTERNAL),
        ("step set_value", INTERNAL),
        ("Arm/set_value", CLIENT),
        ("Arm/set_value", SERVER),
        ("Arm/set_value handler", INTERNAL),
    ]
    step, call = named(found, "step set_value", INTERNAL), named(found, "Arm/set_value", CLIENT)
    assert step.attributes is not None
    assert step.attributes["eal.robot"] == "r1"
    assert [event.name for event in call.events] == ["sent"]
    assert call.start_time is not None
    assert handler.start_time is not None
    assert call.start_time <= call.events[0].timestamp


def test_what_fails_says_with_what_at_both_ends(fleet: Fleet, scenario: Path) -> None:
    exporter = InMemorySpanExporter()
    with Tracing(exporter, "test"):
        run_scenario(scenario, fleet)
    found = exporter.get_finished_spans()
    for name, kind in (
        ("step send_cmd", INTERNAL),
        ("Arm/send_cmd", CLIENT),
        ("Arm/send_cmd", SERVER),
        ("Arm/send_cmd handler", INTERNAL),
    ):
        span = named(found, name, kind)
        assert span.status.status_code is trace.StatusCode.ERROR, name
        assert span.attributes is not None
        assert span.attributes["error.type"] == "resource_fault"


def test_a_robot_of_this_process_is_traced_the_same_way(rig: Rig, scenario: Path) -> None:
    exporter = InMemorySpanExporter()
    with Fleet(rig.local()).connect() as fleet, Tracing(exporter, "test"):
        run_scenario(scenario, fleet)
    found = exporter.get_finished_spans()
    assert line_of(found, named(found, "Arm/set_value handler", INTERNAL)) == [
        ("scenario moves", INTERNAL),
        ("step set_value", INTERNAL),
        ("Arm/set_value", INTERNAL),
        ("Arm/set_value handler", INTERNAL),
    ]


def test_a_program_s_own_span_is_above_its_calls(fleet: Fleet) -> None:
    exporter = InMemorySpanExporter()
    above = trace.SpanContext(0xA1, 0xB2, is_remote=False, trace_flags=trace.TraceFlags(trace.TraceFlags.SAMPLED))
    with Tracing(exporter, "test"):
        with trace.use_span(trace.NonRecordingSpan(above)):
            fleet["r1"]["Arm"].get_value().get()
        fleet["r1"]["Arm"].get_value().get()  # has no parent span
    found = exporter.get_finished_spans()
    assert {span.context.trace_id for span in found} == {0xA1}
    assert [(span.name, span.kind) for span in found if span.parent and span.parent.span_id == 0xB2] == [
        ("Arm/get_value", CLIENT)
    ]


def test_nothing_is_carried_or_kept_where_nobody_traces(fleet: Fleet, scenario: Path) -> None:
    assert spans.tracer is None
    call = fleet["r1"]["Arm"].get_value()
    call.get()
    assert call.span is None
    exporter = InMemorySpanExporter()
    with Tracing(exporter, "test"):
        pass
    run_scenario(scenario, fleet)
    assert exporter.get_finished_spans() == ()


@pytest.mark.parametrize("traceparent", ["", "nonsense", "00-00000000000000000000000000000000-0000000000000000-01"])
def test_a_traceparent_that_makes_no_sense_is_passed_over(fleet: Fleet, traceparent: str) -> None:
    exporter = InMemorySpanExporter()
    with Tracing(exporter, "test"), spans.within(traceparent):
        assert fleet["r1"]["Arm"].get_value().get().value == 0.0
    assert exporter.get_finished_spans() == ()


def test_a_place_that_is_none_is_refused() -> None:
    with pytest.raises(ArgumentError, match="traces need a URL such as"):
        exporter_to("somewhere")
