"""Commands from Modbus carried out on the arrangement in force, and the presets that outlive it."""

import logging
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from trueangle.contract.encoder import EncoderSettings
from trueangle.core.commands import (
    GOOD_RESULTS,
    CommandDesk,
    CommandReport,
    JointSituation,
    Peer,
)
from trueangle.core.node_setup import NodeState
from trueangle.core.presets import PresetBinding
from trueangle.edges.preset_store import PresetFile, load_presets
from trueangle.service.arrangement import Arrangement
from trueangle.serving_settings import mechanics_text

_MAS_PER_DEG = 3_600_000.0
_IN_TROUBLE = (NodeState.FAULT, NodeState.REFUSED, NodeState.CLASH)

_log = logging.getLogger(__name__)


class Commanding:
    """The desk, its file, and the joints it acts on; `core.commands.CommandTarget`."""

    def __init__(
        self,
        directory: Path,
        *,
        arrangement: Callable[[], Arrangement],
        ask_again: Callable[[str, int, str], None],
        note_reference: Callable[[int, float], None],
    ) -> None:
        """ContractError where the stored presets cannot be read. `ask_again(bus, node_id, reason)` has a node
        identified anew; `note_reference(slot, reference_deg)` is told of a reference angle."""
        self._arrangement = arrangement
        self._ask_again = ask_again
        self._note_reference = note_reference
        self._bindings: dict[int, PresetBinding] = {}
        self._file = PresetFile(directory)
        self.desk = CommandDesk(self, self._file, presets=load_presets(directory), report=report)

    async def close(self) -> None:
        """Wait for what is being written."""
        await self._file.close()

    def accepted(self, slot: int, settings: EncoderSettings) -> None:
        """The joint's encoder was read and is the one of its model."""
        joint = self._arrangement().joints.get(slot)
        if joint is None:
            return
        self._bindings[slot] = PresetBinding(
            model_sha256=joint.model.sha256,
            vendor_id=settings.vendor_id,
            product_code=settings.product_code,
            serial_number=settings.serial_number,
            preset_value=settings.preset_value,
            offset_value=settings.offset_value,
            operating_parameters=settings.operating_parameters,
            units_per_revolution=settings.units_per_revolution,
            total_range_units=settings.total_range_units,
            mechanics=mechanics_text(joint.config),
        )
        self.desk.identified(slot, self._bindings[slot])

    def rearranged(self, kept: Iterable[int]) -> None:
        """Another arrangement is in force; only the joints in `kept` go on with the encoders they had."""
        kept = frozenset(kept)
        self._bindings = {slot: binding for slot, binding in self._bindings.items() if slot in kept}
        self.desk.restore()

    def situation(self, slot: int) -> JointSituation | None:
        """See `CommandTarget`."""
        arrangement = self._arrangement()
        if slot not in arrangement.joints:
            return None
        reading = arrangement.pipeline.reading(slot)
        return JointSituation(
            valid=reading.valid,
            model_deg=reading.corrected_deg if reading.valid else None,
            velocity_deg_s=reading.velocity_deg_s,
            binding=self._bindings.get(slot),
        )

    def set_user_zero(self, slot: int, user_zero_mas: int | None) -> None:
        """See `CommandTarget`."""
        zero_deg = None if user_zero_mas is None else user_zero_mas / _MAS_PER_DEG
        self._arrangement().pipeline.set_user_zero(slot, zero_deg, time.monotonic_ns())

    def remove_preset(self, slot: int) -> None:
        """See `CommandTarget`."""
        arrangement = self._arrangement()
        zero_deg = arrangement.joints[slot].config.zero_deg
        arrangement.pipeline.set_user_zero(slot, zero_deg, time.monotonic_ns())

    def clear_fault(self, slot: int) -> None:
        """A jump is taken for right; a node in trouble is identified and set up again."""
        arrangement = self._arrangement()
        arrangement.pipeline.clear_jump(slot, time.monotonic_ns())
        if arrangement.node_state[slot] in _IN_TROUBLE:
            joint = arrangement.joints[slot].config
            self._ask_again(joint.bus, joint.node_id, "clear fault by Modbus")

    def log_reference(self, slot: int, reference_deg: float, peer: Peer) -> None:
        """One line with all that a later look at the model needs."""
        arrangement = self._arrangement()
        reading = arrangement.pipeline.reading(slot)
        self._note_reference(slot, reference_deg)
        _log.info(
            "event=reference_angle slot=%d joint=%r reference_deg=%.9f raw_deg=%s model_deg=%s temperature_c=%s "
            "valid=%d peer=%s role=%r",
            slot,
            arrangement.joints[slot].config.name,
            reference_deg,
            reading.raw_deg,
            reading.corrected_deg,
            reading.temperature_c,
            reading.valid,
            peer.address,
            peer.role,
        )


def report(told: CommandReport) -> None:
    """Commands and presets in the log, with who gave them."""
    level = logging.INFO if told.result in GOOD_RESULTS else logging.WARNING
    _log.log(
        level,
        "event=command what=%s slot=%d result=%s angle_mas=%s user_zero_mas=%s peer=%s role=%r",
        told.event,
        told.slot,
        told.result.name.lower(),
        told.angle_mas,
        told.user_zero_mas,
        told.peer.address,
        told.peer.role,
    )
