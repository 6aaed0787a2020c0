"""OpenTelemetry: a span for each epoch of each node, and inside it one for each operator and edge function.

An epoch is one trace. Its root is the world's span; that of another node has as its parent the span of the node below
it, whose observations came last. Which that is, messages say: each carries the sender's context in its header's
extensions, as W3C Trace Context has it. The span of `predict` links to those of the nodes above, whose context came.

It is on where the environment says so, as OpenTelemetry specifies: ``OTEL_TRACES_EXPORTER``
is ``otlp`` or ``console``. Needs the extra ``[telemetry]``."""

import os
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Header, Message

if TYPE_CHECKING:
    from opentelemetry.sdk.trace.export import SpanExporter
    from opentelemetry.trace import Span, Tracer

EXPORTER_VARIABLE = "OTEL_TRACES_EXPORTER"
OTLP, CONSOLE, NONE = "otlp", "console", "none"
TRACEPARENT, TRACESTATE = "traceparent", "tracestate"  # keys of a header's extensions
FLUSH_S = 2.0  # how long a node that has come to its end waits for its last spans to be sent
_INSTRUMENTATION = "hierax"


def wanted() -> bool:
    """Whether the environment asks for spans. Raises `HieraxError` if it asks for what cannot be had here."""
    name = os.environ.get(EXPORTER_VARIABLE, NONE).strip().lower()
    if name in ("", NONE) or os.environ.get("OTEL_SDK_DISABLED", "").strip().lower() == "true":
        return False
    if name not in (OTLP, CONSOLE):
        raise HieraxError(f"{EXPORTER_VARIABLE}: expected {OTLP}, {CONSOLE} or {NONE}, got {name!r}")
    try:
        import opentelemetry.sdk.trace  # noqa: F401
    except ImportError as error:
        raise HieraxError(f"{EXPORTER_VARIABLE}={name} needs OpenTelemetry: pip install 'hierax[telemetry]'") from error
    return True


def open_spans(hierarchy: str, run: str, node: str, exporter: "SpanExporter | None" = None) -> "Spans":
    """A node's spans; the exporter, by default what the environment says, takes them."""
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

    about = {"service.name": os.environ.get("OTEL_SERVICE_NAME") or hierarchy, "service.instance.id": node}
    resource = Resource.create({**about, "hierax.hierarchy": hierarchy, "hierax.run": run, "hierax.node": node})
    provider = TracerProvider(resource=resource, shutdown_on_exit=False)  # which may wait for half a minute
    provider.add_span_processor(BatchSpanProcessor(exporter or _exporter()))
    return Spans(provider.get_tracer(_INSTRUMENTATION), node, provider.force_flush)


def _exporter() -> "SpanExporter":
    if os.environ.get(EXPORTER_VARIABLE, "").strip().lower() == CONSOLE:
        from opentelemetry.sdk.trace.export import ConsoleSpanExporter

        return ConsoleSpanExporter(out=sys.stderr)
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    except ImportError as error:
        raise HieraxError(f"{EXPORTER_VARIABLE}={OTLP} needs its exporter: pip install 'hierax[telemetry]'") from error
    return OTLPSpanExporter()


class Spans(Watcher):
    """Makes a node's spans; `flush` sends what is not sent yet."""

    def __init__(self, tracer: "Tracer", node: str, flush: Callable[[], object] | None = None) -> None:
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        self._tracer = tracer
        self._node = node
        self._flush = flush
        self._propagator = TraceContextTextMapPropagator()
        self._epoch = (0, 0)
        self._span: Span | None = None
        self._carrier: dict[str, str] = {}
        self._open: dict[int, Span] = {}
        self._acted: dict[int, int] = {}
        self._parent: dict[str, str] = {}
        self._above: dict[str, dict[str, str]] = {}
        self._mark = 0  # nothing yet
        self._works = False

    def received(self, message: Message) -> None:
        if not self._works:
            self._mark = time.time_ns()
        header = message.header
        if header.kind == OBSERVATIONS:
            self._parent = _carried(header)
        elif header.kind == CONTEXT:
            self._above[header.sender] = _carried(header)

    def turned(self) -> None:
        if not self._works:
            self._mark = time.time_ns()

    def called(self, called: Called) -> None:
        from opentelemetry.trace import set_span_in_context

        now = time.time_ns()
        begun, self._mark = self._mark or now, now
        span = self._begin(called.epoch, called.attempt, begun)
        links = self._links() if called.operator == "predict" else ()
        kind = called.operator.partition(" ")[0]  # there may be any number of policies
        name = kind if called.subject == self._node else f"{kind} {called.subject}"
        attributes = {"hierax.operator": called.operator, "hierax.subject": called.subject}
        above = set_span_in_context(span)
        child = self._tracer.start_span(name, above, attributes=attributes, links=links, start_time=begun)
        child.end(self._mark)

    def sending(self, message: Message) -> Message:
        header = message.header
        self._begin(header.epoch, header.attempt, self._mark or time.time_ns())
        if not self._carrier:
            return message
        extensions = {**header.extensions, **self._carrier}
        return message._replace(header=header._replace(extensions=extensions))

    def sent(self, message: Message) -> None:
        self._mark = time.time_ns()

    def acted(self, epoch: int) -> None:
        self._mark = self._acted[epoch] = time.time_ns()

    def completed(self, completed: Completed) -> None:
        epoch = completed.step.epoch
        span = self._open.pop(epoch, None)
        acted = self._acted.pop(epoch, None)  # where the next epoch has begun meanwhile
        if span is not None:
            span.set_attribute("hierax.digest", completed.digest.hex())
            span.end(time.time_ns() if acted is None else acted)

    def served(self) -> None:
        self._works = False

    def close(self) -> None:
        for span in self._open.values():
            _undo(span)
        self._open.clear()
        if self._flush is not None:  # in a thread, as one that does not answer would hold the end up
            flusher = threading.Thread(target=self._flush, name="hierax-spans", daemon=True)
            flusher.start()
            flusher.join(FLUSH_S)

    def _begin(self, epoch: int, attempt: int, begun: int) -> "Span":
        """The span of an epoch, which may be a new one."""
        from opentelemetry.trace import set_span_in_context

        if self._span is not None and self._epoch == (epoch, attempt):
            self._works = True
            return self._span
        undone = self._open.pop(epoch, None)
        if undone is not None:
            _undo(undone)
        self._works = True
        attributes: dict[str, str | int] = {"hierax.node": self._node, "hierax.epoch": epoch, "hierax.attempt": attempt}
        parent = self._propagator.extract(self._parent) if self._parent else None
        span = self._tracer.start_span(f"{self._node} epoch", parent, attributes=attributes, start_time=begun)
        self._epoch, self._span = (epoch, attempt), span
        self._open[epoch] = span
        self._carrier = {}
        self._propagator.inject(self._carrier, set_span_in_context(span))
        return span

    def _links(self) -> list[Any]:
        from opentelemetry.trace import Link, get_current_span

        above, self._above = self._above, {}
        spans = [get_current_span(self._propagator.extract(above[name])) for name in sorted(above) if above[name]]
        return [Link(span.get_span_context()) for span in spans]


def _carried(header: Header) -> dict[str, str]:
    """The trace context in a header, where there is one."""
    extensions = header.extensions
    return {key: str(extensions[key]) for key in (TRACEPARENT, TRACESTATE) if key in extensions}


def _undo(span: "Span") -> None:
    """The epoch is done again, or the node's life is over in the midst of it."""
    span.set_attribute("hierax.undone", True)
    span.end()
