"""Spans of a hierarchy whose nodes are world -> left, and both -> top.most."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from support.deployments import write

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.probe import Step
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.execution.single import run
from hierax.runtime.watch import telemetry
from hierax.runtime.watch.telemetry import Spans
from hierax.schemas.messages import OBSERVATIONS, Header, Message

EPOCHS = 3


class Collected:
    """All spans of a run."""

    def __init__(self) -> None:
        self.exporter = InMemorySpanExporter()
        self._provider = TracerProvider()
        self._provider.add_span_processor(SimpleSpanProcessor(self.exporter))

    def spans(self, node: str) -> Spans:
        return Spans(self._provider.get_tracer("test"), node)

    def named(self, name: str) -> list[ReadableSpan]:
        found = [span for span in self.exporter.get_finished_spans() if span.name == name]
        return sorted(found, key=lambda span: span.start_time or 0)


@pytest.fixture
def collected(tmp_path: Path) -> Collected:
    deployment = read_deployment(write(tmp_path))
    collected = Collected()
    plain = run(deployment, epochs=EPOCHS, seed=2)
    traced = run(deployment, epochs=EPOCHS, seed=2, watch=lambda name, runner: runner.watch(collected.spans(name)))
    assert traced.digest == plain.digest
    return collected


def test_an_epoch_is_one_trace_whose_root_is_the_worlds_span(collected: Collected) -> None:
    roots = collected.named("world epoch")
    assert [root.attributes["hierax.epoch"] for root in roots if root.attributes] == [1, 2, 3]
    assert all(root.parent is None for root in roots)
    traces = [root.context.trace_id for root in roots]
    assert len(set(traces)) == EPOCHS
    spans = collected.exporter.get_finished_spans()
    assert {span.context.trace_id for span in spans} == set(traces)
    per_trace = {trace: sum(span.context.trace_id == trace for span in spans) for trace in traces}
    assert len(set(per_trace.values())) == 1


def test_spans_hang_together(collected: Collected) -> None:
    spans = {span.context.span_id: span for span in collected.exporter.get_finished_spans()}

    def parent(span: ReadableSpan) -> str:
        return "" if span.parent is None else spans[span.parent.span_id].name

    assert {parent(span) for span in collected.named("left epoch")} == {"world epoch"}
    assert {parent(span) for span in collected.named("top.most epoch")} <= {"world epoch", "left epoch"}
    assert {parent(span) for span in collected.named("sense left->top.most")} == {"left epoch"}
    assert {parent(span) for span in collected.named("context left->top.most")} == {"top.most epoch"}
    assert {parent(span) for span in collected.named("observe")} == {"left epoch", "top.most epoch"}


def test_operators_lie_within_their_epochs(collected: Collected) -> None:
    spans = {span.context.span_id: span for span in collected.exporter.get_finished_spans()}
    children = [span for span in spans.values() if not span.name.endswith(" epoch")]
    assert children
    for span in children:
        assert span.parent
        whole = spans[span.parent.span_id]
        assert (whole.start_time or 0) <= (span.start_time or 0) <= (span.end_time or 0)
        assert (span.end_time or 0) <= (whole.end_time or 0)


def test_a_prediction_links_to_those_whose_context_came(collected: Collected) -> None:
    spans = {span.context.span_id: span for span in collected.exporter.get_finished_spans()}
    linked = {
        (spans[span.parent.span_id].name, spans[link.context.span_id].name)
        for span in collected.named("predict")
        for link in span.links
        if span.parent
    }
    assert linked == {
        ("left epoch", "top.most epoch"),
        ("world epoch", "left epoch"),
        ("world epoch", "top.most epoch"),
    }


def test_an_attempt_that_is_undone_ends() -> None:
    collected = Collected()
    spans = collected.spans("arm")
    for attempt in (0, 1):
        spans.received(Message(Header(OBSERVATIONS, "world", "arm", 4, attempt), ()))
        spans.called(Called(4, attempt, "arm", "observe", None))
        spans.served()
    spans.completed(Completed(Step(4, 1, 0.0, (), None, (), (), "default", (), None), b"", bytes(32)))
    first, second = collected.named("arm epoch")
    assert first.attributes
    assert first.attributes["hierax.undone"] is True
    assert second.attributes
    assert "hierax.undone" not in second.attributes
    spans.close()


@pytest.mark.parametrize(
    ("exporter", "disabled", "on"),
    [
        (None, None, False),
        ("none", None, False),
        ("otlp", None, True),
        ("Console", None, True),
        ("otlp", "true", False),
    ],
)
def test_the_environment_decides(
    monkeypatch: pytest.MonkeyPatch, exporter: str | None, disabled: str | None, on: bool
) -> None:
    for name, value in (("OTEL_TRACES_EXPORTER", exporter), ("OTEL_SDK_DISABLED", disabled)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert telemetry.wanted() is on


def test_what_cannot_be_had_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTEL_TRACES_EXPORTER", "zipkin")
    with pytest.raises(HieraxError, match="OTEL_TRACES_EXPORTER: expected otlp, console or none, got 'zipkin'"):
        telemetry.wanted()
    monkeypatch.setenv("OTEL_TRACES_EXPORTER", "otlp")
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    with pytest.raises(HieraxError, match=r"needs OpenTelemetry: pip install 'hierax\[telemetry\]'"):
        telemetry.wanted()


def test_a_nodes_spans_name_its_run() -> None:
    exporter = InMemorySpanExporter()
    spans = telemetry.open_spans("toys", "5163af85", "arm", exporter)
    spans.called(Called(1, 0, "arm", "observe", None))
    spans.close()  # which sends what there is
    names = {span.name for span in exporter.get_finished_spans()}
    assert names == {"observe", "arm epoch"}
    about = exporter.get_finished_spans()[0].resource.attributes
    assert {key: about[key] for key in ("service.name", "hierax.run", "hierax.node")} == {
        "service.name": "toys",
        "hierax.run": "5163af85",
        "hierax.node": "arm",
    }
