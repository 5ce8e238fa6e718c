"""An encoder that also speaks the layer setting services: one unit, two protocols, as on a real bus."""

from dataclasses import dataclass, field

from tests.fakes.encoder_node import EncoderNode
from tests.fakes.lss_unit import LssUnit


@dataclass
class LssEncoder(EncoderNode):
    """`lss.node_id` becomes the node's own at once, as after the reset that units ask for."""

    lss: LssUnit = field(default_factory=lambda: LssUnit((0x1234, 0x5678, 0x0001_0002, 4711)))
    saved: bool = False

    def handle(self, can_id: int, data: bytes) -> None:
        if can_id == 0x7E5:
            answer = self.lss.handle(data)
            if answer is not None:
                self.send(0x7E4, answer)
            return
        super().handle(can_id, data)
