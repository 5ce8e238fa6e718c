"""Metrics in Prometheus' text format (version 0.0.4): one table of what there is, one way to write it.

Rules of this file: every metric stands in `METRICS` and nowhere else; a value that is not known is left out.
Units are in the names, as Prometheus has it: seconds, celsius, counters end in _total.
"""

import enum
from collections.abc import Iterable
from dataclasses import dataclass

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Kind(enum.Enum):
    """How a metric moves."""

    GAUGE = "gauge"
    COUNTER = "counter"
    """Only ever grows, until the process starts again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """One metric; a sample of it has a value for each of the labels."""

    name: str
    kind: Kind
    labels: tuple[str, ...]
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricSample:
    """One value at the moment of the scrape."""

    name: str
    labels: tuple[str, ...]
    """In the order of the metric's labels."""
    value: float


_JOINT, _BUS = ("slot", "joint"), ("bus",)


def _gauge(name: str, meaning: str, *labels: str) -> Metric:
    return Metric(name=f"trueangle_{name}", kind=Kind.GAUGE, labels=labels, meaning=meaning)


def _counter(name: str, meaning: str, *labels: str) -> Metric:
    return Metric(name=f"trueangle_{name}_total", kind=Kind.COUNTER, labels=labels, meaning=meaning)


METRICS: tuple[Metric, ...] = (
    _gauge("joint_valid", "1 while the corrected angle is good", *_JOINT),
    _gauge("joint_status_bit", "1 while this bit of the joint's status word is set", *_JOINT, "bit"),
    _counter("joint_outages", "times that the joint ceased to be valid", *_JOINT),
    _counter("joint_invalid_seconds", "time without a good corrected angle, the start included", *_JOINT),
    _gauge("sample_age_seconds", "age of the position that is served", *_JOINT),
    _gauge("temperature_celsius", "temperature of the joint", *_JOINT),
    _gauge("correction_arcseconds", "what was added to the raw angle; absent where nothing was", *_JOINT),
    _gauge("uncertainty_arcseconds", "standard uncertainty of the corrected angle (k = 1)", *_JOINT),
    _counter("joint_frames", "position frames received", *_JOINT),
    _counter("joint_frames_lost", "positions missing by the node's sequence number", *_JOINT),
    _gauge(
        "calibration_due_timestamp_seconds", "Unix time at which the calibration's due day begins, UTC", *_JOINT
    ),
    _gauge(
        "model_info", "1; the model in force, by the first 16 digits of its SHA-256", *_JOINT, "model", "sha256"
    ),
    _gauge("bus_up", "1 while the CAN bus is open", *_BUS),
    _counter("bus_frames", "frames received", *_BUS),
    _counter("bus_frames_dropped", "frames lost because the process or the kernel was too late", *_BUS),
    _counter("bus_error_frames", "error frames received", *_BUS),
    _counter("bus_frames_sent", "frames sent", *_BUS),
    _counter("bus_send_failures", "frames that could not be sent", *_BUS),
    _counter("bus_syncs_sent", "SYNC sent", *_BUS),
    _counter("bus_syncs_skipped", "periods without a SYNC", *_BUS),
    _counter("bus_openings", "times that the bus was opened", *_BUS),
    _counter("cycles", "cycles: each time that every joint had a new position"),
    _counter("images", "register images published"),
    _counter("misfit_frames", "process data of a wrong length, never decoded"),
    _counter("unready_frames", "process data of nodes that were not in service, never decoded"),
    _gauge("modbus_connections", "open Modbus connections"),
    _counter("modbus_requests", "requests answered, exceptions included"),
    _counter("modbus_exceptions", "requests answered with an exception"),
    _counter("modbus_accepted", "connections accepted"),
    _counter("modbus_refused", "connections closed at once because of a limit"),
    _counter("modbus_broken", "connections closed because of a header that is no Modbus"),
    _counter("modbus_idle_closed", "connections closed because nothing was asked"),
    _counter("reloads", "reloads by outcome: done or refused", "outcome"),
    _gauge("reload_refused", "1 while the last reload was refused: files and service differ"),
    _gauge("start_time_seconds", "Unix time of the start"),
    _gauge("info", "1; the version", "version"),
)
_BY_NAME = {metric.name: metric for metric in METRICS}


def render_metrics(samples: Iterable[MetricSample]) -> str:
    """The text of a scrape, in the order of the table; ValueError for what is not in it."""
    lines: dict[str, list[str]] = {}
    for sample in samples:
        metric = _BY_NAME.get(sample.name)
        if metric is None or len(metric.labels) != len(sample.labels):
            raise ValueError(f"sample: expected a metric of the table with its labels, got {sample}")
        pairs = ",".join(
            f'{name}="{_label(value)}"' for name, value in zip(metric.labels, sample.labels, strict=True)
        )
        name = f"{metric.name}{{{pairs}}}" if pairs else metric.name
        lines.setdefault(metric.name, []).append(f"{name} {_number(sample.value)}\n")
    return "".join(
        f"# HELP {metric.name} {_help(metric.meaning)}\n# TYPE {metric.name} {metric.kind.value}\n"
        + "".join(lines[metric.name])
        for metric in METRICS
        if metric.name in lines
    )


def render_metric_table() -> str:
    """The table as Markdown."""
    rows = ("| name | kind | labels | meaning |", "| --- | --- | --- | --- |")
    return "".join(
        f"{row}\n"
        for row in (
            *rows,
            *(f"| {m.name} | {m.kind.value} | {', '.join(m.labels)} | {m.meaning} |" for m in METRICS),
        )
    )


def _label(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _help(text: str) -> str:
    return text.replace("\\", "\\\\").replace("\n", "\\n")


def _number(value: float) -> str:
    """As Go reads it: whole numbers without an exponent or a point, NaN and infinities by name."""
    if value != value:
        return "NaN"
    if value in (float("inf"), float("-inf")):
        return "+Inf" if value > 0 else "-Inf"
    return str(int(value)) if value == int(value) and abs(value) < 2**53 else repr(float(value))
