"""`--trace` of `eal run` and `eal serve`: two processes and a collector."""

from __future__ import annotations

import gzip
import json
import signal
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

from tests.net.links import free_port


class Collector:
    """A collector of OTLP over HTTP, which keeps spans by service and name."""

    def __init__(self) -> None:
        self.spans: dict[tuple[str, str], Any] = {}
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if self.headers.get("Content-Encoding") == "gzip":
                    body = gzip.decompress(body)
                assert self.path == "/v1/traces"
                collector.keep(ExportTraceServiceRequest.FromString(body))
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"

    def keep(self, request: Any) -> None:
        for of_service in request.resource_spans:
            about = {item.key: item.value.string_value for item in of_service.resource.attributes}
            for of_scope in of_service.scope_spans:
                for span in of_scope.spans:
                    self.spans[about["service.name"], span.name] = span


@pytest.fixture
def collector() -> Iterator[Collector]:
    collector = Collector()
    thread = threading.Thread(target=collector.server.serve_forever)
    thread.start()
    yield collector
    collector.server.shutdown()
    thread.join()
    collector.server.server_close()


@pytest.fixture
def served(slides: Path) -> Path:
    text = slides.read_text(encoding="utf-8").replace("  two: {plugins: {slide: {}}}\n", "")
    slides.write_text(text.replace("  one: {", f"  one: {{address: 'tcp/127.0.0.1:{free_port()}', "))
    return slides


def test_two_processes_send_one_trace(start: Any, served: Path, move: Path, collector: Collector) -> None:
    robot = start("serve", "--fleet", served, "--robot", "one", "--trace", collector.url)
    assert any(line == f"traces to {collector.url}\n" for line in iter(robot.stdout.readline, ""))
    assert "serves" in robot.stdout.readline()
    run = start("run", move, "--fleet", served, "--no-plot", "--trace", collector.url)
    out, problems = run.communicate(timeout=90)
    assert run.returncode == 0, out + problems
    robot.send_signal(signal.SIGTERM)
    robot.communicate(timeout=60)
    found, here, there = collector.spans, "eal run", "eal serve one"
    line = [
        found[here, "scenario move"],
        found[here, "step send_cmd"],
        found[here, "Slide/send_cmd"],
        found[there, "Slide/send_cmd"],
        found[there, "Slide/send_cmd handler"],
    ]
    assert [span.parent_span_id for span in line] == [b"", *(span.span_id for span in line[:-1])]
    assert len({span.trace_id for span in line}) == 1
    assert [span.kind for span in line] == [1, 1, 3, 2, 1]  # internal, client, server: the numbers of the protocol


def test_the_environment_sets_destination_and_service(
    eal: Any, slides: Path, move: Path, tmp_path: Path, collector: Collector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OTEL_TRACES_EXPORTER", "otlp")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", collector.url)
    monkeypatch.setenv("OTEL_SERVICE_NAME", "the lab")
    result = eal("run", move, "--fleet", slides, "--no-plot", "--runs-dir", tmp_path / "runs")
    assert result.exit_code == 0
    assert ("the lab", "Slide/send_cmd handler") in collector.spans


def test_traces_on_the_console_leave_stdout_alone(eal: Any, slides: Path, move: Path, tmp_path: Path) -> None:
    result = eal(
        "run", move, "--fleet", slides, "--no-plot", "--json", "--trace", "console", "--runs-dir", tmp_path / "runs"
    )
    assert json.loads(result.stdout)["outcome"] == "done"
    assert '"name": "step send_cmd"' in result.stderr


@pytest.mark.parametrize("where", ["URL", "otlp"])
def test_robots_move_without_the_collector_and_one_line_says_so(
    start: Any, slides: Path, move: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """OpenTelemetry printed its exceptions, a line for each attempt."""
    url = f"http://127.0.0.1:{free_port()}"
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", url)
    trace = url if where == "URL" else where
    run = start("run", move, "--fleet", slides, "--no-plot", "--trace", trace, "--runs-dir", tmp_path / "runs")
    _, problems = run.communicate(timeout=90)
    assert run.returncode == 0
    (line,) = problems.splitlines()
    assert "no collector takes the traces: start one" in line
    assert f"endpoint={url}/v1/traces" in line
    assert "Connection refused" in line
    assert "HTTPConnectionPool" not in line


def test_an_invalid_destination_is_refused_before_anything_moves(
    eal: Any, slides: Path, move: Path, tmp_path: Path
) -> None:
    result = eal("run", move, "--fleet", slides, "--trace", "somewhere", "--runs-dir", tmp_path / "runs")
    assert result.exit_code == 2
    assert "traces need a URL such as http://127.0.0.1:4318" in result.stderr
    assert not (tmp_path / "runs").exists()
