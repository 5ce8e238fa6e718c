"""The defects whose names a report may use."""

from collections.abc import Callable

import numpy as np

from trueangle_training.plant.defect import Defect
from trueangle_training.plant.reading_head import grating_defects, mechanical_defects, thermal_defects
from trueangle_training.plant.reading_head.contribution import Setting

Maker = Callable[[Setting, np.random.Generator], Defect]

LIBRARY_DEFECTS: dict[str, Maker] = {
    "eccentricity": grating_defects.eccentricity,
    "grating_tilt": grating_defects.grating_tilt,
    "graduation_error": grating_defects.graduation_error,
    "localized_defect": grating_defects.localized_defect,
    "subdivision_error": grating_defects.subdivision_error,
    "quantisation": grating_defects.quantisation,
    "count_loss": grating_defects.count_loss,
    "thermal_eccentricity": thermal_defects.thermal_eccentricity,
    "thermal_tilt": thermal_defects.thermal_tilt,
    "thermal_graduation": thermal_defects.thermal_graduation,
    "thermal_nonlinearity": thermal_defects.thermal_nonlinearity,
    "thermal_lag": thermal_defects.thermal_lag,
    "temperature_sensor_error": thermal_defects.temperature_sensor_error,
    "self_heating": thermal_defects.self_heating,
    "hysteresis": mechanical_defects.hysteresis,
    "windup": mechanical_defects.windup,
    "bearing_wobble": mechanical_defects.bearing_wobble,
    "load_deflection": mechanical_defects.load_deflection,
    "index_drift": mechanical_defects.index_drift,
    "read_latency": mechanical_defects.read_latency,
    "reference_artefact": mechanical_defects.reference_artefact,
    "run_to_run_eccentricity": mechanical_defects.run_to_run_eccentricity,
    "noise_growth": mechanical_defects.noise_growth,
}
