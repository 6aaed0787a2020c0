"""A launch tells a collector of its epochs: one trace each, across processes."""

from __future__ import annotations

import gzip
import threading
from collections import Counter
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import NamedTuple

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from support.live import Program, environment, hierax

EPOCHS = 5


class Span(NamedTuple):
    """What matters of one."""

    node: str
    trace: bytes
    id: bytes
    parent: bytes
    name: str


class Collector(ThreadingHTTPServer):
    """Takes spans in as OpenTelemetry's protocol has it, over HTTP."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.spans: list[Span] = []


class _Handler(BaseHTTPRequestHandler):
    server: Collector

    def do_POST(self) -> None:
        data = self.rfile.read(int(self.headers["content-length"]))
        if self.headers.get("content-encoding") == "gzip":
            data = gzip.decompress(data)
        request = ExportTraceServiceRequest()
        request.ParseFromString(data)
        for resource in request.resource_spans:
            about = {each.key: each.value.string_value for each in resource.resource.attributes}
            for scope in resource.scope_spans:
                self.server.spans += [
                    Span(about["hierax.node"], each.trace_id, each.span_id, each.parent_span_id, each.name)
                    for each in scope.spans
                ]
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        return


@pytest.fixture
def collector() -> Iterator[Collector]:
    with Collector() as collector:
        thread = threading.Thread(target=collector.serve_forever)
        thread.start()
        yield collector
        collector.shutdown()
        thread.join()


def test_spans_of_all_processes_hang_together(collector: Collector, tmp_path: Path) -> None:
    told = {
        **environment(tmp_path),
        "OTEL_TRACES_EXPORTER": "otlp",
        "OTEL_EXPORTER_OTLP_ENDPOINT": f"http://127.0.0.1:{collector.server_port}",
    }
    program = Program(["launch", "servo", "--epochs", str(EPOCHS)], told)
    try:
        assert program.ends() == 0, program.err
    finally:
        program.kill()
    traces = Counter(span.trace for span in collector.spans)
    assert len(traces) == EPOCHS
    assert len(set(traces.values())) == 1
    by_id = {span.id: span for span in collector.spans}
    parents = {
        (span.node, span.name, by_id[span.parent].name if span.parent else "")
        for span in collector.spans
        if span.name.endswith(" epoch")
    }
    assert parents == {
        ("world", "world epoch", ""),
        ("camera", "camera epoch", "world epoch"),
        ("motion", "motion epoch", "camera epoch"),
    }


def test_what_is_wrong_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTEL_TRACES_EXPORTER", "zipkin")
    for mode in ("run", "launch"):
        done = hierax(tmp_path, mode, "servo", "--epochs", "2")
        assert done.returncode == 1
        assert done.stderr == "error: OTEL_TRACES_EXPORTER: expected otlp, console or none, got 'zipkin'\n"
