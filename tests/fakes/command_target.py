"""Joints that commands act on, and a store that is as slow or as broken as a test wants it."""

from collections.abc import Callable, Iterable
from dataclasses import replace

from trueangle.core.commands import JointSituation, Peer
from trueangle.core.presets import Preset, PresetBinding

BINDING = PresetBinding(model_sha256="ab" * 32, vendor_id=0x159, product_code=7, serial_number=4711)
STANDING = JointSituation(valid=True, model_deg=100.0, velocity_deg_s=0.0, binding=BINDING)


class FakeJoints:
    """Slots 1 and 2, standing still at 100 degrees."""

    def __init__(self) -> None:
        self.joints: dict[int, JointSituation] = {1: STANDING, 2: STANDING}
        self.zeros: dict[int, int | None] = {}
        self.cleared: list[int] = []
        self.references: list[tuple[int, float, str]] = []

    def change(self, slot: int, **changes: object) -> None:
        self.joints[slot] = replace(self.joints[slot], **changes)  # pyright: ignore[reportArgumentType]

    def situation(self, slot: int) -> JointSituation | None:
        return self.joints.get(slot)

    def set_user_zero(self, slot: int, user_zero_mas: int | None) -> None:
        self.zeros[slot] = user_zero_mas

    def remove_preset(self, slot: int) -> None:
        self.zeros[slot] = 0

    def clear_fault(self, slot: int) -> None:
        self.cleared.append(slot)

    def log_reference(self, slot: int, reference_deg: float, peer: Peer) -> None:
        self.references.append((slot, reference_deg, peer.address))


class FakeStore:
    """Answers at once, unless `slow`: then when told to."""

    def __init__(self) -> None:
        self.saved: list[tuple[Preset, ...]] = []
        self.works = True
        self.slow = False
        self.waiting: list[Callable[[bool], None]] = []

    def save(self, presets: Iterable[Preset], done: Callable[[bool], None]) -> None:
        self.saved.append(tuple(presets))
        if self.slow:
            self.waiting.append(done)
        else:
            done(self.works)
