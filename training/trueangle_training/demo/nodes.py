"""The process of the demo's six encoder nodes: `python -m trueangle_training.demo.nodes DIR --rate HZ`."""

import argparse
import sys
from pathlib import Path

from trueangle_training.demo.joints import JOINTS, live_joint
from trueangle_training.documents import load_joint
from trueangle_training.simulator.canopen_node import NodeSpec
from trueangle_training.simulator.node_process import run_nodes


def main() -> int:
    """Run the nodes of the joints in DIR until told to stop or until the parent is gone."""
    parser = argparse.ArgumentParser(prog="nodes")
    parser.add_argument("directory", type=Path)
    parser.add_argument(
        "--rate", type=float, required=True, help="SYNC rate in Hz that the joints' movement assumes"
    )
    parser.add_argument("--can", help="SocketCAN interface; left out, a socketcand on loopback")
    options = parser.parse_args()
    specs: list[NodeSpec] = []
    for number in range(1, JOINTS + 1):
        joint = load_joint(options.directory / f"joint-{number}.yaml")
        live = live_joint(joint, number, 1.0 / options.rate)
        specs.append(
            NodeSpec(node_id=number, settings=joint.encoder.settings, sample=live.sample, name=joint.name)
        )
    run_nodes(specs, can_channel=options.can)
    return 0


if __name__ == "__main__":
    sys.exit(main())
