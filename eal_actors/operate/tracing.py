"""Tracing: OpenTelemetry spans of this process (Source: https://opentelemetry.io/docs/specs/otel/trace/).

    with Tracing("http://127.0.0.1:4318", "eal run"):
        ...

A run of a scenario is a trace. Its spans are the steps, their calls, and the handling of the calls by the robots, in
all processes. A call without a span above it, such as a dashboard's poll of a pose, is not traced.
"""

from __future__ import annotations

import logging
import sys
import threading
from contextlib import AbstractContextManager
from typing import Final, Self
from urllib.parse import urlsplit

from opentelemetry import context, trace
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import SERVICE_NAME, SERVICE_VERSION, OTELResourceDetector, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor, ConsoleSpanExporter, SpanExporter
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
from typing_extensions import override

from eal_actors.actors.robot_view import release
from eal_actors.kernel import spans
from eal_actors.kernel.errors import ArgumentError, EALError, error_text
from eal_actors.kernel.log import get_logger

CONSOLE: Final = "console"
"""Spans as JSON on stderr."""
OTLP: Final = "otlp"
"""Spans to the endpoint in OTEL_EXPORTER_OTLP_ENDPOINT, by default http://localhost:4318."""
_PATH: Final = "/v1/traces"
_SDK_LOGGERS: Final = ("opentelemetry.exporter", "opentelemetry.sdk")
_CLOSE_S: Final = 3.0  # real seconds to wait for the collector at the end
_W3C: Final = TraceContextTextMapPropagator()
_KINDS: Final[dict[spans.Kind, trace.SpanKind]] = {"internal": trace.SpanKind.INTERNAL, "client": trace.SpanKind.CLIENT}


def exporter_to(where: str) -> SpanExporter:
    """Return the exporter to stderr (CONSOLE), to a collector at a URL by HTTP, or to that of the variables (OTLP).

    Raises ArgumentError if `where` is none of these.
    """
    if where == CONSOLE:
        return ConsoleSpanExporter(out=sys.stderr)
    if where == OTLP:
        return OTLPSpanExporter()
    parts = urlsplit(where)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ArgumentError(f"traces need a URL such as http://127.0.0.1:4318, or {OTLP} or {CONSOLE}, not {where!r}")
    return OTLPSpanExporter(endpoint=where if parts.path.strip("/") else f"{where.rstrip('/')}{_PATH}")


class _LostTraces(logging.Handler):
    """Logs the first problem of an exporter, in place of the SDK's lines, which are one for each attempt.

    Python prints lines of a logger without a handler; a program's own handlers still get them.
    """

    def __init__(self, exporter: SpanExporter) -> None:
        super().__init__(logging.WARNING)
        self._about = {"endpoint": endpoint} if (endpoint := getattr(exporter, "_endpoint", None)) else {}
        self._is_reported = False

    @override
    def emit(self, record: logging.LogRecord) -> None:
        if not self._is_reported:
            self._is_reported = True
            get_logger().warning(
                "no collector takes the traces: start one, or set --trace or OTEL_EXPORTER_OTLP_ENDPOINT to its URL",
                **self._about,
                reason=_reason(record),
            )


def _reason(record: logging.LogRecord) -> str:
    """Return the text of the first cause of a line's exception, such as "Connection refused"; or of the line."""
    given = (*(record.args if isinstance(record.args, tuple) else ()), *(record.exc_info or ()))
    error = next((one for one in given if isinstance(one, BaseException)), None)
    while error is not None and (cause := error.__cause__ or error.__context__):
        error = cause
    return record.getMessage() if error is None else str(error)


class Tracing(spans.Tracer):
    """Traces this process for the length of a `with` block.

    The environment variables of OpenTelemetry's SDK apply, such as OTEL_SERVICE_NAME, OTEL_TRACES_SAMPLER and
    OTEL_EXPORTER_OTLP_HEADERS. `exporter` is one, or its name for exporter_to. Its queue is bounded: when it is full,
    spans are dropped. `service` is the name of this process, unless the environment sets one. Thread: any; blocks only
    at the end, until the collector has the rest or _CLOSE_S are over. Raises ArgumentError as exporter_to does.
    """

    def __init__(self, exporter: SpanExporter | str, service: str) -> None:
        self._exporter = exporter_to(exporter) if isinstance(exporter, str) else exporter
        about = {SERVICE_NAME: service, SERVICE_VERSION: release(), **OTELResourceDetector().detect().attributes}
        self._lost = _LostTraces(self._exporter)
        self._provider = TracerProvider(resource=Resource.create(about), shutdown_on_exit=False)
        self._provider.add_span_processor(BatchSpanProcessor(self._exporter))
        self._tracer = self._provider.get_tracer("eal_actors", release())

    def __enter__(self) -> Self:
        for name in _SDK_LOGGERS:
            logging.getLogger(name).addHandler(self._lost)
        self._uninstall = spans.install(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._uninstall()
        time_out = threading.Timer(_CLOSE_S, self._exporter.shutdown)
        time_out.daemon = True
        time_out.start()
        self._provider.shutdown()
        time_out.cancel()
        time_out.join()
        for name in _SDK_LOGGERS:
            logging.getLogger(name).removeHandler(self._lost)

    @override
    def begin(self, name: str, about: spans.About, kind: spans.Kind = "internal") -> spans.Span | None:
        above = trace.get_current_span().get_span_context()
        if not above.is_valid:
            return None
        role = trace.SpanKind.SERVER if above.is_remote else _KINDS[kind]
        return _Span(self._tracer, self._tracer.start_span(name, kind=role, attributes=about))

    @override
    def begin_trace(self, name: str, about: spans.About) -> spans.Span:
        return _Span(self._tracer, self._tracer.start_span(name, context.Context(), attributes=about))

    @override
    def within(self, traceparent: str) -> AbstractContextManager[object]:
        # W3C Trace Context: an invalid traceparent is ignored.
        above = trace.get_current_span(_W3C.extract({"traceparent": traceparent}, context.Context()))
        return trace.use_span(above, record_exception=False, set_status_on_exception=False)


class _Span(spans.Span):
    __slots__ = ("_span", "_tracer")

    def __init__(self, tracer: trace.Tracer, span: trace.Span) -> None:
        self._tracer = tracer
        self._span = span

    @property
    @override
    def traceparent(self) -> str:
        carrier: dict[str, str] = {}
        _W3C.inject(carrier, trace.set_span_in_context(self._span, context.Context()))
        return carrier.get("traceparent", "")

    @override
    def current(self) -> AbstractContextManager[object]:
        return trace.use_span(self._span, record_exception=False, set_status_on_exception=False)

    @override
    def part(self, name: str) -> spans.Span:
        above = trace.set_span_in_context(self._span, context.Context())
        return _Span(self._tracer, self._tracer.start_span(name, above))

    @override
    def note(self, event: str) -> None:
        self._span.add_event(event)

    @override
    def end(self, error: BaseException | None = None) -> None:
        if error is not None:
            self._span.set_attribute("error.type", error.code if isinstance(error, EALError) else type(error).__name__)
            self._span.set_status(trace.StatusCode.ERROR, error_text(error))
        self._span.end()
