"""Tracing: spans of this process, given to OpenTelemetry (Source: https://opentelemetry.io/docs/specs/otel/trace/).

    with Tracing("http://127.0.0.1:4318", "eal run"):
        ...

A run of a scenario is a trace; its steps, their calls, and what the robots' resources do for them are its spans, in
whichever process. What nobody traces further up, such as a dashboard's look at the poses, is not traced here either.
"""

from __future__ import annotations

import sys
import threading
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Final, Self
from urllib.parse import urlsplit

from opentelemetry import context, trace
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import SERVICE_NAME, SERVICE_VERSION, OTELResourceDetector, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor, ConsoleSpanExporter, SpanExporter
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from eal_actors.actors.robot_view import release
from eal_actors.kernel import spans
from eal_actors.kernel.errors import ArgumentError, EALError, error_text

CONSOLE: Final = "console"
"""Spans as JSON on stderr."""
OTLP: Final = "otlp"
"""Spans to where OTEL_EXPORTER_OTLP_ENDPOINT says; http://localhost:4318 if it says nothing."""
_PATH: Final = "/v1/traces"
_CLOSE_S: Final = 3.0
"""Real seconds after which a collector that does not answer is not tried again."""
_W3C: Final = TraceContextTextMapPropagator()
_KINDS: Final[dict[spans.Kind, trace.SpanKind]] = {
    "internal": trace.SpanKind.INTERNAL,
    "client": trace.SpanKind.CLIENT,
}


def exporter_to(where: str) -> SpanExporter:
    """Return what takes spans to a collector, or prints them.

    Args:
        where: CONSOLE, OTLP, or the URL of a collector that speaks OTLP over HTTP.

    Raises:
        ArgumentError: it is none of these.
    """
    if where == CONSOLE:
        return ConsoleSpanExporter(out=sys.stderr)
    if where == OTLP:
        return OTLPSpanExporter()
    parts = urlsplit(where)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ArgumentError(f"traces go to a URL such as http://127.0.0.1:4318, or to {CONSOLE}, not to {where!r}")
    return OTLPSpanExporter(endpoint=where if parts.path.strip("/") else f"{where.rstrip('/')}{_PATH}")


class Tracing:
    """Traces this process for the length of a `with` block.

    The environment variables that OpenTelemetry's SDK defines count, such as OTEL_SERVICE_NAME, OTEL_TRACES_SAMPLER
    and OTEL_EXPORTER_OTLP_HEADERS.

    Args:
        exporter: where spans go, or its name; see exporter_to. Spans wait in a bounded queue, and those that find it
            full are dropped.
        service: what this process is called, where the environment says nothing.

    Thread: any; blocks only at the end, until the collector has what is left, or is given up.

    Raises:
        ArgumentError: see exporter_to.
    """

    def __init__(self, exporter: SpanExporter | str, service: str) -> None:
        self._exporter = exporter_to(exporter) if isinstance(exporter, str) else exporter
        about = {SERVICE_NAME: service, SERVICE_VERSION: release(), **OTELResourceDetector().detect().attributes}
        self._provider = TracerProvider(resource=Resource.create(about), shutdown_on_exit=False)
        self._provider.add_span_processor(BatchSpanProcessor(self._exporter))
        self._tracer = self._provider.get_tracer("eal_actors", release())

    def __enter__(self) -> Self:
        self._uninstall = spans.install(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._uninstall()
        impatience = threading.Timer(_CLOSE_S, self._exporter.shutdown)
        impatience.daemon = True
        impatience.start()
        self._provider.shutdown()
        impatience.cancel()
        impatience.join()

    # See spans.Tracer.

    def begin(self, name: str, about: spans.About, kind: spans.Kind = "internal") -> spans.Span | None:
        """See spans.Tracer: what another process began is served here."""
        above = trace.get_current_span().get_span_context()
        if not above.is_valid:
            return None
        return _Span(
            self._tracer,
            self._tracer.start_span(
                name, kind=trace.SpanKind.SERVER if above.is_remote else _KINDS[kind], attributes=about
            ),
        )

    def begin_trace(self, name: str, about: spans.About) -> spans.Span:
        """See spans.Tracer."""
        return _Span(self._tracer, self._tracer.start_span(name, context.Context(), attributes=about))

    def within(self, traceparent: str) -> AbstractContextManager[object]:
        """See spans.Tracer; what makes no sense is passed over, as W3C Trace Context demands."""
        above = trace.get_current_span(_W3C.extract({"traceparent": traceparent}, context.Context()))
        return trace.use_span(above, record_exception=False, set_status_on_exception=False)


class _Span:
    """See spans.Span."""

    __slots__ = ("_span", "_tracer")

    def __init__(self, tracer: trace.Tracer, span: trace.Span) -> None:
        self._tracer = tracer
        self._span = span

    @property
    def traceparent(self) -> str:
        carrier: dict[str, str] = {}
        _W3C.inject(carrier, trace.set_span_in_context(self._span, context.Context()))
        return carrier.get("traceparent", "")

    def current(self) -> AbstractContextManager[object]:
        return trace.use_span(self._span, record_exception=False, set_status_on_exception=False)

    def part(self, name: str) -> spans.Span:
        above = trace.set_span_in_context(self._span, context.Context())
        return _Span(self._tracer, self._tracer.start_span(name, above))

    def note(self, event: str) -> None:
        self._span.add_event(event)

    def end(self, error: BaseException | None = None) -> None:
        if error is not None:
            self._span.set_attribute("error.type", error.code if isinstance(error, EALError) else type(error).__name__)
            self._span.set_status(trace.StatusCode.ERROR, error_text(error))
        self._span.end()
