"""Conditions in which every effect of the library has shapes, for the tests of effects and simulator."""

import numpy as np

from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import Joint, joint_from_document
from trueangle_training.effects.conditions import Conditions

LINES = 1000
COUNTS = 1_000_000
BASE_C = 20.0


def joint_of(effects: object, **others: object) -> Joint:
    """A joint with a 23-face polygon, without noise unless asked for."""
    values = {
        "schema_version": 1,
        "encoder": {"lines_per_rev": LINES, "counts_per_rev": COUNTS},
        "reference": {"kind": "polygon", "faces": 23},
        "effects": effects,
    }
    return joint_from_document(document_from_plain({**values, **others}, source="made in code"))


def rich_conditions(seed: int = 0, *, joint: Joint | None = None) -> Conditions:
    """Eight runs of 46 readings: both directions, two loads, two speeds, several turns, all columns there."""
    rng = np.random.default_rng(seed)
    runs, readings = 8, 46
    size = runs * readings
    run = np.repeat(np.arange(1, runs + 1), readings)
    upwards = np.tile(np.repeat([1.0, -1.0], readings // 2), runs)
    place = np.tile(np.concatenate([np.arange(23), np.arange(22, -1, -1)]), runs)
    return Conditions(
        angle_deg=place * (720.0 / 23) + rng.uniform(-0.02, 0.02, size),
        run=run,
        zero_group=(run + 1) // 2,
        lines_per_rev=LINES,
        counts_per_rev=COUNTS,
        base_temperature_c=BASE_C,
        temperature_c=np.repeat(rng.uniform(10.0, 40.0, runs), readings) + rng.uniform(-0.1, 0.1, size),
        time_s=(run - 1) * 2000.0 + np.tile(np.arange(readings) * 15.0, runs),
        direction=upwards,
        velocity_deg_s=upwards * np.where(run % 2 == 0, 10.0, 40.0),
        load_nm=np.where(np.arange(size) % 3 == 0, 12.0, 0.0),
        face=place % 23 + 1,
        polygon_offset=run % 3,
        faces=23,
        joint=joint,
    )
