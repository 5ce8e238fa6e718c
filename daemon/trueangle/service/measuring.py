"""What the metrics say of the running service: read from its plain counters at the moment of a scrape."""

import datetime
from collections.abc import Iterator, Mapping

from trueangle.core.health import StatusBit
from trueangle.core.metrics import MetricSample
from trueangle.edges.modbus_server import ModbusCounters
from trueangle.service.arrangement import Arrangement
from trueangle.service.bus_line import BusLine
from trueangle.service.joints import LoadedJoint
from trueangle.service.reloading import ReloadRecord
from trueangle.version import own_version


def service_samples(
    arrangement: Arrangement,
    lines: Mapping[str, BusLine],
    modbus: ModbusCounters,
    reloads: ReloadRecord,
    *,
    now_ns: int,
    started_s: float,
) -> Iterator[MetricSample]:
    """Every sample; `now_ns` is monotonic, `started_s` Unix time."""
    for slot, joint in arrangement.joints.items():
        yield from _joint_samples(arrangement, slot, joint, now_ns)
    for name, line in lines.items():
        yield from _bus_samples(name, line)
    counters = arrangement.pipeline.counters
    for name in ("cycles", "images", "misfit_frames", "unready_frames"):
        yield _one(f"{name}_total", getattr(counters, name))
    yield _one("modbus_connections", modbus.connections)
    for name in ("requests", "exceptions", "accepted", "refused", "broken", "idle_closed"):
        yield _one(f"modbus_{name}_total", getattr(modbus, name))
    yield _one("reloads_total", reloads.succeeded, "done")
    yield _one("reloads_total", reloads.refused, "refused")
    yield _one("reload_refused", bool(reloads.refusal))
    yield _one("start_time_seconds", started_s)
    yield _one("info", 1, own_version())


def _joint_samples(arrangement: Arrangement, slot: int, joint: LoadedJoint, now_ns: int) -> Iterator[MetricSample]:
    labels = (str(slot), joint.config.name)
    outages = arrangement.outages[slot]
    yield _one("joint_outages_total", outages.outages, *labels)
    yield _one("joint_invalid_seconds_total", outages.invalid_s(now_ns), *labels)
    yield _one("model_info", 1, *labels, joint.config.model, joint.model.sha256[:16])
    due = joint.model.metadata.calibration.due
    if due is not None:
        day = datetime.datetime.fromisoformat(due).replace(tzinfo=datetime.UTC)
        yield _one("calibration_due_timestamp_seconds", day.timestamp(), *labels)
    state = arrangement.pipeline.states.get(slot)
    if state is None:
        return
    yield _one("joint_valid", StatusBit.VALID in state.status, *labels)
    for bit in StatusBit:
        if bit not in (StatusBit.VALID, StatusBit.CONFIGURED):
            yield _one("joint_status_bit", bit in state.status, *labels, (bit.name or "").lower())
    for name, value in (
        ("sample_age_seconds", None if state.age_ms is None else state.age_ms / 1000),
        ("temperature_celsius", state.temperature_c),
        ("correction_arcseconds", state.correction_arcsec),
        ("uncertainty_arcseconds", state.uncertainty_arcsec),
        ("joint_frames_total", state.frames_received),
        ("joint_frames_lost_total", state.frames_lost),
    ):
        if value is not None:
            yield _one(name, value, *labels)


def _bus_samples(name: str, line: BusLine) -> Iterator[MetricSample]:
    counters = line.counters
    yield _one("bus_up", line.up, name)
    for metric, value in (
        ("frames", counters.frames),
        ("frames_dropped", counters.frames_dropped),
        ("error_frames", counters.error_frames),
        ("frames_sent", counters.sent),
        ("send_failures", counters.send_failures),
        ("syncs_sent", counters.sync_sent),
        ("syncs_skipped", counters.sync_skipped),
        ("openings", counters.times_opened),
    ):
        yield _one(f"bus_{metric}_total", value, name)


def _one(name: str, value: float, *labels: str) -> MetricSample:
    return MetricSample(name=f"trueangle_{name}", labels=labels, value=float(value))
