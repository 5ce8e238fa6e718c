"""Time to build one register image. Run as `python tests/benchmarks/bench_registers.py`."""

import datetime
import statistics
import time

from trueangle.core.health import StatusBit
from trueangle.core.registers import JointIdentity, JointState, RegisterMap

ROUNDS = 31
IMAGES = 500


def register_map(joints: int) -> RegisterMap:
    """Slots 1..joints, fully described."""
    return RegisterMap(
        JointIdentity(
            slot=slot,
            node_id=slot,
            model_id=bytes(8),
            calibration_date=datetime.date(2026, 1, 1),
            calibration_due=datetime.date(2027, 1, 1),
            vendor_id=1,
            product_code=2,
            revision_number=3,
            serial_number=slot,
        )
        for slot in range(1, joints + 1)
    )


def joint_states(joints: int) -> dict[int, JointState]:
    """Valid joints with every field known."""
    return {
        slot: JointState(
            status=StatusBit.VALID | StatusBit.CONFIGURED,
            sequence=slot,
            corrected_deg=10.123456 * slot,
            raw_deg=10.12 * slot,
            correction_arcsec=12.4416 * slot,
            temperature_c=23.5,
            age_ms=1.25,
            uncertainty_arcsec=2.5,
            velocity_deg_s=-30.0,
            turns=0,
            raw_counts=123_456,
            frames_received=1_000_000,
            frames_lost=0,
        )
        for slot in range(1, joints + 1)
    }


def main() -> None:
    """Print median and fastest round per number of joints."""
    for joints in (1, 6, 32):
        built, states = register_map(joints), joint_states(joints)
        rounds_us: list[float] = []
        for _ in range(ROUNDS):
            start_s = time.perf_counter()
            for cycle in range(IMAGES):
                built.image(cycle=cycle, heartbeat=cycle, service_status=1, states=states)
            rounds_us.append((time.perf_counter() - start_s) / IMAGES * 1e6)
        median_us, fastest_us = statistics.median(rounds_us), min(rounds_us)
        print(f"{joints:2d} joints: {median_us:.1f} us an image (median of {ROUNDS}, fastest {fastest_us:.1f})")


if __name__ == "__main__":
    main()
