"""How far a campaign shows the drift of its own datum."""

import numpy as np

from trueangle_training.evaluation.held_out import temperature_groups
from trueangle_training.methods import TrainingReadings


def shows_datum_drift(readings: TrainingReadings) -> bool:
    """Whether readings at different temperatures share a zero: only those tell how the datum moves."""
    if readings.zero_group is None:
        return False
    group = temperature_groups(readings)
    pairs = np.unique(np.stack([readings.zero_group, group]), axis=1)
    return bool(np.unique(pairs[0]).size < pairs.shape[1])
