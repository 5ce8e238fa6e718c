"""Six joints of one arm: the shipped example with other amplitudes, mountings, serial numbers and movements."""

import copy
from importlib import resources
from pathlib import Path

from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import Joint, joint_from_document, joint_to_plain
from trueangle_training.documents import load_joint
from trueangle_training.simulator.joint import simulated_joint
from trueangle_training.simulator.trajectory import LiveJoint, Trajectory

JOINTS = 6
NAMES = ("base", "shoulder", "elbow", "forearm", "wrist", "probe")
VENDOR_ID = 0x0000_0F0F
PRODUCT_CODE = 0x406
SERIAL_NUMBER_BASE = 26_110_000
SCALING_ON = 4
"""0x6000 with the scaling function on, code sequence clockwise."""

_AMPLITUDE_FACTORS = (1.0, 0.9, 1.1, 0.85, 1.15, 1.0)
_MOUNTED_DEG = (0.0, 8.0, -6.0, 12.0, -3.0, 5.0)
"""By how much each grating is turned on its shaft: moves the phase of order n by n times this angle."""
_SPEEDS_DEG_S = (37.0, -29.0, 53.0, 41.0, -61.0, 47.0)
"""Different for each joint, so that they cross the seam at different times, and in both directions."""
_START_C, _END_C, _RAMP_S = 11.0, 39.0, 8.0
"""Inside the campaign's 10 to 40 degC: outside, the daemon rightly refuses to correct."""


def example_path(name: str) -> Path:
    """A shipped example file."""
    return Path(str(resources.files("trueangle_training").joinpath("examples", name)))


def demo_joint(number: int) -> Joint:
    """Joint 1..6: amplitudes scaled, grating turned, with an encoder identity of its own."""
    factor = _AMPLITUDE_FACTORS[number - 1]
    document = copy.deepcopy(joint_to_plain(load_joint(example_path("joint.yaml"))))
    document["name"] = NAMES[number - 1]
    document["encoder"]["settings"] = {
        "vendor_id": VENDOR_ID,
        "product_code": PRODUCT_CODE,
        "serial_number": SERIAL_NUMBER_BASE + number,
        "operating_parameters": SCALING_ON,
        "units_per_revolution": document["encoder"]["counts_per_rev"],
        "preset_value": 0,
    }
    for name, settings in document["effects"].items():
        for harmonic in settings.get("harmonics", [settings]):
            order = harmonic.get("order", 2 if name.endswith("tilt") else 1)
            phase_deg = harmonic["phase_deg"] + order * _MOUNTED_DEG[number - 1]
            harmonic["phase_deg"] = (phase_deg + 180.0) % 360.0 - 180.0
            for key in harmonic:
                if key.startswith("amplitude"):
                    harmonic[key] *= factor
    return joint_from_document(document_from_plain(document, source=f"joint {number} of the demo"))


def live_joint(joint: Joint, number: int, sample_period_s: float) -> LiveJoint:
    """The joint as it moves in the demo: both processes, node and judge, build the same one."""
    return LiveJoint(
        simulated=simulated_joint(joint),
        trajectory=Trajectory(
            start_deg=60.0 * (number - 1),
            speed_deg_s=_SPEEDS_DEG_S[number - 1],
            start_c=_START_C,
            end_c=_END_C,
            ramp_s=_RAMP_S + number,
        ),
        sample_period_s=sample_period_s,
        seed=number,
    )
