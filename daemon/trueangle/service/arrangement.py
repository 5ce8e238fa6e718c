"""One configuration in force: its joints, their pipeline and registers, and what is known of their nodes.

An arrangement is replaced as a whole between two cycles (`take_over`); a joint whose entry and model are what they
were keeps its samples and its node.
"""

import logging
import time
from collections.abc import Callable, Collection, Mapping, Sequence

from trueangle.config import DaemonConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.core.calendar_day import LatestDay
from trueangle.core.carry_over import CarriedOver, NodeKey, carried_over
from trueangle.core.frames import NodePlan
from trueangle.core.health import NodeCondition, StatusBit
from trueangle.core.node_setup import NodeReport, NodeState
from trueangle.core.outage import LogLine, OutageLog, reason_words
from trueangle.core.pipeline import Frame, Pipeline
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.process_data import node_plans
from trueangle.service.joints import (
    Loaded,
    LoadedJoint,
    encoder_differences,
    joint_channel,
    joint_identity,
)
from trueangle.serving_settings import head_differences, range_counts

SETTLE_S = 1.0
"""A node in service for so long without a valid angle has had its chance: the service is ready without it."""

_CONDITIONS = {
    NodeState.RUNNING: NodeCondition.RUNNING,
    NodeState.REFUSED: NodeCondition.DIFFERS,
    NodeState.FAULT: NodeCondition.FAULT,
    NodeState.CLASH: NodeCondition.ID_CLASH,
}
_DECIDED = (NodeState.RUNNING, NodeState.REFUSED, NodeState.FAULT, NodeState.CLASH, NodeState.LOST)

_log = logging.getLogger(__name__)


class Arrangement:
    """The joints of one configuration; all methods on the loop's thread."""

    def __init__(
        self,
        loaded: Loaded,
        *,
        publish: Callable[[RegisterImage], None],
        on_clash: Callable[[str, int, str], None],
        today: LatestDay,
        on_accepted: Callable[[int, EncoderSettings], None] | None = None,
    ) -> None:
        """`on_clash(bus, node_id, reason)` asks for a node to be identified anew.

        `today` outlives the arrangement: a reload must not make a calibration good again that was past due.

        `on_accepted(slot, settings)` is called when the encoder was read and fits, before it is served.
        """
        self.config: DaemonConfig = loaded.config
        self.joints: Mapping[int, LoadedJoint] = {joint.config.slot: joint for joint in loaded.joints}
        self._plans = {bus.name: node_plans(self.config.joints, bus.name) for bus in self.config.buses}
        self._on_accepted = on_accepted
        self.pipeline = Pipeline(
            [joint_channel(joint) for joint in loaded.joints],
            RegisterMap([joint_identity(joint) for joint in loaded.joints]),
            publish=publish,
            on_status=self._on_status,
            sensors=[(bus, plan) for bus, plans in self._plans.items() for plan in plans],
            on_clash=on_clash,
            today=today,
        )
        now_ns = time.monotonic_ns()
        self.outages = {slot: OutageLog(slot, joint.config.name, now_ns) for slot, joint in self.joints.items()}
        self._process_data = {bus.name: self.pipeline.process_data(bus.name) for bus in loaded.config.buses}
        self.node_state = dict.fromkeys(self.joints, NodeState.UNKNOWN)
        self.node_since_ns = dict.fromkeys(self.joints, now_ns)
        """Since when each node is in its state, monotonic."""
        self.buses_down: dict[str, str] = {}
        self.first_accepted: dict[tuple[int, int], EncoderSettings] = {}
        """Of each slot and head: what it must stay, also where neither model nor configuration say anything."""

    def take_over(self, previous: "Arrangement", buses: Mapping[str, bool]) -> CarriedOver:
        """Go on where `previous` ends; gives what goes on as if nothing had happened.

        `buses`: those that stay open, each up or not. `previous` must not be used again.
        """
        unchanged = {
            slot
            for slot, joint in self.joints.items()
            if joint.config.bus in buses
            and (joint.config.temperature.bus or joint.config.bus) in buses
            and slot in previous.joints
            and joint.config == previous.joints[slot].config
            and joint.model.sha256 == previous.joints[slot].model.sha256
        }
        kept = carried_over(unchanged, previous.node_plans(buses), self.node_plans(buses))
        state = previous.pipeline.hand_on()
        self.pipeline.take_over(state, buses=buses, slots=kept.slots, nodes=kept.nodes)
        for slot in kept.slots:
            self.node_state[slot] = previous.node_state[slot]
            self.node_since_ns[slot] = previous.node_since_ns[slot]
        same = {
            slot
            for slot in self.joints.keys() & previous.joints.keys()
            if _same_encoders(self.joints[slot], previous.joints[slot])
        }
        self.first_accepted = {at: told for at, told in previous.first_accepted.items() if at[0] in same}
        for slot, outage in previous.outages.items():
            if slot in self.joints and self.joints[slot].config.name == previous.joints[slot].config.name:
                self.outages[slot] = outage
                if slot not in kept.slots:
                    outage.restart(time.monotonic_ns())
        self.buses_down = {name: text for name, text in previous.buses_down.items() if name in buses}
        return kept

    def node_plans(self, buses: Collection[str]) -> dict[NodeKey, NodePlan]:
        """What the nodes of these buses are to send."""
        return {(bus, plan.node_id): plan for bus in self._plans.keys() & buses for plan in self._plans[bus]}

    def plans(self, bus: str) -> list[NodePlan]:
        """What the nodes of this bus are to send."""
        return self._plans[bus]

    def process_data(self, bus: str) -> frozenset[int]:
        """The COB-IDs on this bus that are the pipeline's."""
        return self._process_data[bus]

    def on_frames(self, bus: str, frames: Sequence[Frame]) -> None:
        """A batch of frames; the master has seen those that are its own."""
        self.pipeline.on_frames(bus, frames, time.monotonic_ns())

    def on_sync(self, bus: str, stamp_ns: int) -> None:
        """A SYNC is about to leave."""
        self.pipeline.on_sync(bus, stamp_ns)

    def on_bus_state(self, bus: str, *, up: bool, reason: str) -> None:
        """The bus was opened or lost."""
        if up:
            self.buses_down.pop(bus, None)
        else:
            self.buses_down[bus] = reason
        self.pipeline.on_bus(bus, up=up, now_ns=time.monotonic_ns())

    def on_node(self, slot: int, report: NodeReport) -> None:
        """A node's life cycle moved on."""
        now_ns = time.monotonic_ns()
        if report.head == 0:
            self.node_state[slot] = report.state
            self.node_since_ns[slot] = now_ns
        unready = NodeCondition.SILENT if report.silent else NodeCondition.NOT_READY
        condition = _CONDITIONS.get(report.state, unready)
        self.pipeline.on_node(
            slot, condition, now_ns, head=report.head, range_counts=range_counts(report.settings)
        )

    def on_sensor(self, bus: str, node_id: int, report: NodeReport) -> None:
        """The life cycle of any node moved on; those without an encoder are told so alone."""
        condition = _CONDITIONS.get(report.state, NodeCondition.NOT_READY)
        self.pipeline.on_sensor(bus, node_id, condition, time.monotonic_ns())

    def accept(self, slot: int, settings: EncoderSettings) -> list[str]:
        """Why this encoder must not be corrected with the joint's model; empty where it may."""
        differences = self._differences(slot, 0, settings, encoder_differences(self.joints[slot], settings))
        if not differences and self._on_accepted is not None:
            self._on_accepted(slot, settings)
        return differences

    def accept_head(self, slot: int, head: int, settings: EncoderSettings) -> list[str]:
        """The same for one of the joint's further heads."""
        return self._differences(slot, head, settings, head_differences(self.joints[slot].config, head, settings))

    def _differences(self, slot: int, head: int, settings: EncoderSettings, differences: list[str]) -> list[str]:
        """`differences`, or else what has changed since the encoder was first accepted.

        A zero set at the unit itself, or a unit exchanged for its like, moves the phase all the same.
        """
        if differences:
            return differences
        first = self.first_accepted.setdefault((slot, head), settings)
        return [f"{text} since the start; restart to accept it" for text in settings.differences_from(first)]

    def _on_status(self, slot: int, before: StatusBit, after: StatusBit) -> None:
        del before  # the outage log keeps its own account
        _say(self.outages[slot].change(after, time.monotonic_ns()))

    def tick(self, now_ns: int) -> None:
        """What is due in the log although nothing changed."""
        for outage in self.outages.values():
            _say(outage.tick(now_ns))

    def decided(self, now_ns: int) -> bool:
        """Whether each joint is served, or its trouble has been reported."""
        return all(self._decided(slot, now_ns) for slot in self.joints)

    def _decided(self, slot: int, now_ns: int) -> bool:
        if StatusBit.VALID in self.pipeline.statuses[slot] or self.joints[slot].config.bus in self.buses_down:
            return True
        state = self.node_state[slot]
        settled = now_ns - self.node_since_ns[slot] > SETTLE_S * 1e9
        return state in _DECIDED and (state is not NodeState.RUNNING or settled)

    def status_text(self) -> str:
        """One line: how many joints are valid, and what the others suffer from."""
        statuses = self.pipeline.statuses
        valid = sum(StatusBit.VALID in status for status in statuses.values())
        troubles = [
            f"{self.joints[slot].config.name}: {reasons(status)}"
            for slot, status in statuses.items()
            if StatusBit.VALID not in status
        ]
        text = f"{valid} of {len(statuses)} joints valid"
        return f"{text}; {'; '.join(troubles)}" if troubles else text


def _same_encoders(one: LoadedJoint, other: LoadedJoint) -> bool:
    """Whether the encoders of one joint are to be those of the other."""
    names = ("bus", "node_id", "encoder", "further_heads")
    same = all(getattr(one.config, name) == getattr(other.config, name) for name in names)
    return same and one.model.sha256 == other.model.sha256


def reasons(status: StatusBit) -> str:
    """The bits that speak against a joint, as words."""
    return ",".join(reason_words(status)) or "none"


def _say(lines: list[LogLine]) -> None:
    for line in lines:
        _log.log(logging.WARNING if line.warning else logging.INFO, "%s", line.text)
