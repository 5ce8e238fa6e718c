"""What one cycle of six joints costs: frames in, six model passes, one register image out; CPU time alone."""

import statistics
import struct
import time
from pathlib import Path

from trueangle.config import parse_config
from trueangle.core.health import NodeCondition
from trueangle.core.pipeline import Pipeline
from trueangle.core.registers import RegisterImage, RegisterMap
from trueangle.edges.onnx_model import load_model
from trueangle.service import LoadedJoint, joint_channel, joint_identity

MODELS = Path(__file__).parents[1] / "data" / "models"
ROUNDS, CYCLES = 9, 2000
JOINT = """
  - slot: {slot}
    name: joint {slot}
    bus: arm
    node_id: {slot}
    model: good.onnx
    encoder: {{counts_per_rev: 3276800}}
    temperature: {{index: 0x7130, subindex: 1, degc_per_unit: 0.01}}
    sequence: {{index: 0x2100, subindex: 0}}
"""


def main() -> None:
    """Print medians over rounds."""
    text = "schema_version: 1\nbuses: [{name: arm, interface: virtual, channel: c}]\njoints:"
    text += "".join(JOINT.format(slot=slot) for slot in range(1, 7))
    model = load_model(MODELS / "good.onnx")
    joints = [LoadedJoint(config=joint, model=model) for joint in parse_config(text, source="bench").joints]
    images: list[RegisterImage] = []
    pipeline = Pipeline(
        [joint_channel(joint) for joint in joints],
        RegisterMap([joint_identity(joint) for joint in joints]),
        publish=images.append,
        on_status=lambda *_: None,
    )
    now_ns = time.monotonic_ns()
    pipeline.on_bus("arm", up=True, now_ns=now_ns)
    for slot in range(1, 7):
        pipeline.on_node(slot, NodeCondition.RUNNING, now_ns)
        pipeline.on_frames("arm", [(0x280 + slot, struct.pack("<h", 2000), now_ns)], now_ns)
    sequence = 0
    costs_us: list[float] = []
    for round_number in range(ROUNDS + 1):
        images.clear()
        started_ns = time.process_time_ns()
        for _ in range(CYCLES):
            sequence += 1
            now_ns = time.monotonic_ns()
            pipeline.on_sync("arm", now_ns)
            frame = struct.pack("<IH", sequence * 977 % 3_276_800, sequence & 0xFFFF)
            pipeline.on_frames("arm", [(0x180 + slot, frame, now_ns) for slot in range(1, 7)], now_ns)
        if round_number == 0:
            continue  # nothing is warm yet, and the very first samples are believed only with the second
        costs_us.append((time.process_time_ns() - started_ns) / CYCLES / 1e3)
        assert len(images) == CYCLES
    cycle_us = statistics.median(costs_us)
    print(f"one cycle of six joints: {cycle_us:.0f} us CPU (median of {ROUNDS} rounds of {CYCLES};")
    print(f"  {min(costs_us):.0f} to {max(costs_us):.0f}); at 200 Hz {cycle_us * 200 / 1e4:.1f} % of a core,")
    print(f"  at 1 kHz {cycle_us * 1000 / 1e4:.1f} %")


if __name__ == "__main__":
    main()
