"""Is a trained model fit to be served? What a training without complaint does not tell.

Two signs of a useless model can be had without any reference: it leaves the readings nearly as they were, or it
passes through them and swings far beyond them in between.
"""

import numpy as np

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.dataset import TrainingSet, centred_rms
from trueangle_training.methods import ErrorModel

LARGEST_SWING_OVER_READINGS = 0.5
ANGLE_STEPS = 1441
TEMPERATURE_STEPS = 31


def check_model(model: ErrorModel, data: TrainingSet, *, source: str) -> None:
    """ContractError where the model fits no better than none, or swings beyond its readings between them."""
    readings = data.readings
    left = readings.error_arcsec - model.error_arcsec(readings.angle_deg, readings.temperature_c)
    # From the mean of each group, because a group's own zero is no error of the model.
    left_rms, raw_rms = centred_rms(left, readings), data.raw_centred_rms_arcsec
    faults: list[Fault] = []
    if not left_rms < raw_rms / 2:
        expected = f"a model that leaves less than half of the raw error ({raw_rms:.3g} arcsec RMS)"
        advice = "train with another seed or more hidden nodes, or look whether the angle is another joint's"
        faults.append(Fault(where=source, expected=expected, found=f"{left_rms:.3g} arcsec RMS", advice=advice))
    angle_deg, temperature_c = (
        axis.ravel()
        for axis in np.meshgrid(
            np.linspace(data.valid_angle_deg.minimum, data.valid_angle_deg.maximum, ANGLE_STEPS),
            np.linspace(data.valid_temperature_c.minimum, data.valid_temperature_c.maximum, TEMPERATURE_STEPS),
        )
    )
    swing = model.error_arcsec(angle_deg, temperature_c)
    lowest, highest = float(readings.error_arcsec.min()), float(readings.error_arcsec.max())
    room = LARGEST_SWING_OVER_READINGS * (highest - lowest)
    if not (lowest - room <= float(swing.min()) and float(swing.max()) <= highest + room):
        expected = f"a model between {lowest - room:.4g} and {highest + room:.4g} arcsec, near its readings"
        found = f"{float(swing.min()):.4g} to {float(swing.max()):.4g} arcsec inside the valid ranges"
        faults.append(Fault(where=source, expected=expected, found=found, advice="measure more angles"))
    if faults:
        raise ContractError(faults)
