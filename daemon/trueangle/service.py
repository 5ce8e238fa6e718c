"""The composition root: configuration and models in, a running service out.

Data flow: CAN bus -> pipeline -> register image -> Modbus server; what is not process data goes to the CANopen
master; every change of a joint's status word is logged once. The watchdog is fed where an image is published and
nowhere else, so a pipeline that stands still is seen by systemd.
"""

import asyncio
import datetime
import logging
import signal
import time
from collections.abc import Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path

from trueangle.config import DaemonConfig, JointConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import Interval
from trueangle.core.frames import Trigger
from trueangle.core.health import INFORMATION, Limits, NodeCondition, StatusBit
from trueangle.core.node_setup import NodeReport, NodeState
from trueangle.core.pipeline import Frame, JointChannel, Pipeline
from trueangle.core.registers import JointIdentity, RegisterImage, RegisterMap
from trueangle.core.sample import SampleScale
from trueangle.edges.can_bus import CanBus, bus_faults
from trueangle.edges.can_master import CanMaster
from trueangle.edges.modbus_server import ModbusLimits, ModbusTcpServer
from trueangle.edges.onnx_model import OnnxModel, load_model
from trueangle.edges.systemd import ServiceNotifier
from trueangle.process_data import node_plan, node_plans, plan_faults

TICK_S = 0.01
"""Ages in the registers are renewed at least this often, and a joint gone stale is marked within it."""
IMAGE_AGE_S = 3 * TICK_S
"""No image older than this is served: after a stall the joints are judged anew before the first answer, and a
pipeline that stands still does not leave its last angle valid."""
SETTLE_S = 1.0
"""A node in service for so long without a valid angle has had its chance: the service is ready without it."""
STATUS_TEXT_S = 1.0

_CONDITIONS = {
    NodeState.RUNNING: NodeCondition.RUNNING,
    NodeState.REFUSED: NodeCondition.DIFFERS,
    NodeState.FAULT: NodeCondition.FAULT,
    NodeState.CLASH: NodeCondition.ID_CLASH,
}
_DECIDED = (NodeState.RUNNING, NodeState.REFUSED, NodeState.FAULT, NodeState.CLASH, NodeState.LOST)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedJoint:
    """One joint of the configuration with its checked model."""

    config: JointConfig
    model: OnnxModel


def check_buses(config: DaemonConfig, *, source: str) -> None:
    """ContractError where a bus can never be opened as it is configured; a bus that is only absent is no fault."""
    faults: list[Fault] = []
    for i, bus in enumerate(config.buses):
        faults += bus_faults(bus, where=f"{source}, buses[{i}]")
    faults += plan_faults(config, source=source)
    if faults:
        raise ContractError(faults)


def load_joints(config: DaemonConfig, *, base: Path, source: str) -> tuple[LoadedJoint, ...]:
    """Load and check every model file of the configuration; ContractError with the faults of all of them.

    Model paths are relative to `base`, the configuration file's directory.
    """
    faults: list[Fault] = []
    loaded: list[LoadedJoint] = []
    for i, joint in enumerate(config.joints):
        try:
            model = load_model(base / joint.model, pinned_sha256=joint.model_sha256)
        except ContractError as error:
            faults += error.faults
            continue
        faults += _model_against_config(model, joint, f"{source}, joints[{i}]")
        loaded.append(LoadedJoint(config=joint, model=model))
    faults += _models_used_twice(loaded, source)
    if faults:
        raise ContractError(faults)
    return tuple(loaded)


def _models_used_twice(loaded: list[LoadedJoint], source: str) -> list[Fault]:
    """A model belongs to one encoder on one shaft: on a second joint it is the wrong one."""
    faults: list[Fault] = []
    first: dict[str, str] = {}
    for joint in loaded:
        name = joint.config.name
        if joint.model.sha256 in first:
            found = f"{joint.config.model} is also that of {first[joint.model.sha256]}"
            faults.append(Fault(where=f"{source}, joint {name}", expected="a model of its own", found=found))
        first.setdefault(joint.model.sha256, name)
    return faults


def _model_against_config(model: OnnxModel, joint: JointConfig, where: str) -> list[Fault]:
    """Model and configuration must mean the same encoder."""
    encoder = model.metadata.encoder
    faults: list[Fault] = []
    if encoder is not None and encoder.counts_per_rev != joint.encoder.counts_per_rev:
        expected = f"counts_per_rev {encoder.counts_per_rev} as at the calibration of {joint.model}"
        faults.append(Fault(where=where, expected=expected, found=str(joint.encoder.counts_per_rev)))
    configured = joint.encoder.settings.known()
    for name, value in model.metadata.encoder_settings.known().items():
        if name in configured and configured[name] != value:
            expected = f"{name} {value} as at the calibration of {joint.model}"
            faults.append(Fault(where=where, expected=expected, found=str(configured[name])))
    return faults


def encoder_differences(joint: LoadedJoint, found: EncoderSettings) -> list[str]:
    """Why this encoder must not be corrected with this model; empty where it may."""
    differences: list[str] = []
    counts_per_rev = found.counts_per_rev
    if counts_per_rev != joint.config.encoder.counts_per_rev:
        expected = joint.config.encoder.counts_per_rev
        shown = "not readable" if counts_per_rev is None else str(counts_per_rev)
        differences.append(f"counts per revolution expected {expected} found {shown}")
    range_units = found.total_range_units
    if range_units is not None and (range_units or 2**32) % joint.config.encoder.counts_per_rev:
        # The position would wrap in the middle of a turn and show another angle from then on.
        differences.append(f"total_range_units {range_units} is no whole number of turns")
    for expected in (joint.config.encoder.settings, joint.model.metadata.encoder_settings):
        differences += [text for text in found.differences_from(expected) if text not in differences]
    return differences


def joint_channel(joint: LoadedJoint) -> JointChannel:
    """What the pipeline needs of a joint."""
    config, metadata = joint.config, joint.model.metadata
    return JointChannel(
        slot=config.slot,
        bus=config.bus,
        plan=node_plan(config),
        scale=SampleScale(
            counts_per_rev=config.encoder.counts_per_rev,
            degc_per_unit=config.temperature.degc_per_unit,
            offset_c=config.temperature.offset_c,
            sequence_modulus=None if config.sequence is None else 1 << config.sequence.bits,
            temperature_by_change=config.temperature.tpdo.trigger is Trigger.EVENT,
            synchronous=config.tpdo.trigger is Trigger.SYNC,
            position_period_ms=config.tpdo.period_ms if config.tpdo.trigger is Trigger.TIMER else None,
        ),
        limits=Limits(
            stale_ms=config.stale_ms,
            temperature_stale_s=config.temperature.stale_s,
            sensor_range_c=Interval(minimum=config.temperature.minimum_c, maximum=config.temperature.maximum_c),
            model_angle_deg=metadata.valid_angle_deg,
            model_temperature_c=metadata.valid_temperature_c,
        ),
        model=joint.model,
        temperature_node=config.temperature.node_id,
        temperature_has_status=config.temperature.status is not None,
    )


def joint_identity(joint: LoadedJoint) -> JointIdentity:
    """What the registers say of joint, model and encoder."""
    calibration = joint.model.metadata.calibration
    settings = joint.model.metadata.encoder_settings
    return JointIdentity(
        slot=joint.config.slot,
        node_id=joint.config.node_id,
        model_id=bytes.fromhex(joint.model.sha256)[:8],
        calibration_date=datetime.date.fromisoformat(calibration.date),
        calibration_due=None if calibration.due is None else datetime.date.fromisoformat(calibration.due),
        vendor_id=settings.vendor_id,
        product_code=settings.product_code,
        revision_number=settings.revision_number,
        serial_number=settings.serial_number,
    )


class Service:
    """The running daemon; `run` returns after a signal or `stop`."""

    def __init__(self, config: DaemonConfig, joints: tuple[LoadedJoint, ...], notifier: ServiceNotifier) -> None:
        self._config = config
        self._joints: Mapping[int, LoadedJoint] = {joint.config.slot: joint for joint in joints}
        self._notifier = notifier
        modbus = config.modbus
        self._server = ModbusTcpServer(
            modbus.host,
            modbus.port,
            unit_id=modbus.unit_id,
            limits=ModbusLimits(
                connections=modbus.max_connections,
                connections_per_address=modbus.max_connections_per_address,
                idle_timeout_s=modbus.idle_timeout_s,
                image_age_s=IMAGE_AGE_S,
            ),
            refresh=lambda: self._pipeline.tick(time.monotonic_ns()),
        )
        self._pipeline = Pipeline(
            [joint_channel(joint) for joint in joints],
            RegisterMap([joint_identity(joint) for joint in joints]),
            publish=self._publish,
            on_status=self._on_status,
            sensors=[(bus.name, plan) for bus in config.buses for plan in node_plans(config.joints, bus.name)],
            on_clash=self._on_clash,
        )
        self._masters: dict[str, CanMaster] = {}
        self._buses: dict[str, CanBus] = {}
        self._dropped = dict.fromkeys((bus.name for bus in config.buses), 0)
        self._process_data = {bus.name: self._pipeline.process_data(bus.name) for bus in config.buses}
        self._node_state = dict.fromkeys(self._joints, NodeState.UNKNOWN)
        self._node_since_ns = dict.fromkeys(self._joints, 0)
        self._buses_down: dict[str, str] = {}
        self._invalid_since_ns: dict[int, int] = dict.fromkeys(self._joints, time.monotonic_ns())
        self._fed_ns = 0
        self._status_ns = 0
        self._ready = False
        self._stop = asyncio.Event()

    def stop(self) -> None:
        """Ask for an orderly stop."""
        self._stop.set()

    async def run(self) -> None:
        """Serve until stopped. Raises LinkError where the Modbus port cannot be had."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.stop)
        # The default would end the process at once, in the middle of whatever it does.
        loop.add_signal_handler(signal.SIGHUP, _log.warning, "event=sighup_ignored reason='restart to reload'")
        try:
            async with AsyncExitStack() as stack:
                await self._server.start()
                stack.push_async_callback(self._server.close)
                for joint in self._joints.values():
                    if joint.model.metadata.encoder_settings.serial_number is None:
                        _log.warning(
                            "event=model_not_bound joint=%r model=%s", joint.config.name, joint.config.model
                        )
                await self._open_buses(stack)
                # Once more, to come before the buses: while they close, the last image would pass for fresh.
                stack.push_async_callback(self._server.close)
                stack.callback(self._notifier.stopping)
                await self._tick_until_stopped()
        finally:
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
                loop.remove_signal_handler(number)
        _log.info("event=stopped images=%d", self._pipeline.counters.images)

    async def _open_buses(self, stack: AsyncExitStack) -> None:
        for settings in self._config.buses:
            name = settings.name
            bus = CanBus(
                settings,
                on_frames=lambda frames, name=name: self._on_frames(name, frames),
                on_bus_state=lambda up, reason, name=name: self._on_bus_state(name, up=up, reason=reason),
                on_sync=lambda stamp_ns, name=name: self._pipeline.on_sync(name, stamp_ns),
            )
            master = CanMaster(
                bus,
                node_plans(self._config.joints, name),
                on_node=self._on_node,
                accept=self._accept,
                on_sensor=lambda node_id, report, name=name: self._on_sensor(name, node_id, report),
                on_value=self._pipeline.on_value,
                on_alive=lambda node_id, stamp_ns, name=name: self._pipeline.on_alive(name, node_id, stamp_ns),
            )
            self._buses[name] = bus
            self._masters[name] = await stack.enter_async_context(master)
            await stack.enter_async_context(bus)

    async def _tick_until_stopped(self) -> None:
        while not self._stop.is_set():
            try:
                await asyncio.wait_for(self._stop.wait(), TICK_S)
            except TimeoutError:
                now_ns = time.monotonic_ns()
                last_ns = self._pipeline.last_image_ns
                if last_ns is None or now_ns - last_ns >= TICK_S * 1e9:
                    self._pipeline.tick(now_ns)
                self._tell_systemd(now_ns)

    def _on_frames(self, bus: str, frames: list[Frame]) -> None:
        process_data, master = self._process_data[bus], self._masters[bus]
        dropped = self._buses[bus].counters.frames_dropped
        if dropped > self._dropped[bus]:
            # Among them may have been the boot-up message of a node that now sends another mapping.
            master.distrust(f"{dropped - self._dropped[bus]} frames of the bus were dropped")
            self._dropped[bus] = dropped
        for cob_id, data, _ in frames:
            if cob_id not in process_data:
                master.notify(cob_id, data)
        self._pipeline.on_frames(bus, frames, time.monotonic_ns())

    def _on_bus_state(self, bus: str, *, up: bool, reason: str) -> None:
        if up:
            self._buses_down.pop(bus, None)
        else:
            self._buses_down[bus] = reason
        self._masters[bus].on_bus_state(up, reason)
        self._pipeline.on_bus(bus, up=up, now_ns=time.monotonic_ns())

    def _accept(self, slot: int, settings: EncoderSettings) -> list[str]:
        return encoder_differences(self._joints[slot], settings)

    def _on_node(self, slot: int, report: NodeReport) -> None:
        now_ns = time.monotonic_ns()
        self._node_state[slot] = report.state
        self._node_since_ns[slot] = now_ns
        self._pipeline.on_node(slot, _CONDITIONS.get(report.state, NodeCondition.NOT_READY), now_ns)

    def _on_sensor(self, bus: str, node_id: int, report: NodeReport) -> None:
        condition = _CONDITIONS.get(report.state, NodeCondition.NOT_READY)
        self._pipeline.on_sensor(bus, node_id, condition, time.monotonic_ns())

    def _on_clash(self, slot: int, reason: str) -> None:
        joint = self._joints[slot].config
        self._masters[joint.bus].distrust_node(joint.node_id, reason)

    def _on_status(self, slot: int, before: StatusBit, after: StatusBit) -> None:
        now_ns = time.monotonic_ns()
        name = self._joints[slot].config.name
        if StatusBit.VALID in after:
            lasted_s = (now_ns - self._invalid_since_ns.get(slot, now_ns)) * 1e-9
            _log.info(
                "event=joint_valid slot=%d joint=%r after_s=%.3f was=%s", slot, name, lasted_s, reasons(before)
            )
            return
        if StatusBit.VALID in before:
            self._invalid_since_ns[slot] = now_ns
        _log.warning("event=joint_not_valid slot=%d joint=%r reasons=%s", slot, name, reasons(after))

    def _publish(self, image: RegisterImage) -> None:
        self._server.publish(image)
        interval_s = self._notifier.watchdog_interval_s
        if interval_s is not None and self._ready:
            now_ns = time.monotonic_ns()
            if now_ns - self._fed_ns >= interval_s * 1e9 and self._server.listening:
                self._fed_ns = now_ns
                self._notifier.alive()

    def _tell_systemd(self, now_ns: int) -> None:
        if not self._ready and all(self._decided(slot, now_ns) for slot in self._joints):
            self._ready = True
            text = self.status_text()
            _log.info("event=ready status=%r", text)
            self._notifier.ready(text)
        elif now_ns - self._status_ns >= STATUS_TEXT_S * 1e9:
            self._status_ns = now_ns
            self._notifier.status(self.status_text())

    def _decided(self, slot: int, now_ns: int) -> bool:
        """Whether the joint is served, or its trouble has been reported."""
        if StatusBit.VALID in self._pipeline.statuses[slot] or self._joints[slot].config.bus in self._buses_down:
            return True
        state = self._node_state[slot]
        settled = now_ns - self._node_since_ns[slot] > SETTLE_S * 1e9
        return state in _DECIDED and (state is not NodeState.RUNNING or settled)

    def status_text(self) -> str:
        """One line: how many joints are valid, and what the others suffer from."""
        statuses = self._pipeline.statuses
        valid = sum(StatusBit.VALID in status for status in statuses.values())
        troubles = [
            f"{self._joints[slot].config.name}: {reasons(status)}"
            for slot, status in statuses.items()
            if StatusBit.VALID not in status
        ]
        text = f"{valid} of {len(statuses)} joints valid"
        return f"{text}; {'; '.join(troubles)}" if troubles else text


def reasons(status: StatusBit) -> str:
    """The bits that speak against a joint, as words."""
    against = status & ~(StatusBit.VALID | StatusBit.CONFIGURED | INFORMATION)
    return ",".join(bit.name.lower() for bit in against if bit.name) or "none"
