"""The one cause of the library that lies in the reference."""

import numpy as np

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.metrological.chain import Bench, Part
from trueangle_training.plant.metrological.joint_known import HIGHEST_ORDER, any_phase
from trueangle_training.plant.schedule import FACES


def reference_artefact(bench: Bench, rng: np.random.Generator) -> Defect:
    """An old certificate, and a cross hair that is not upright, so that the faces' tilt is read as angle."""
    at = 2.0 * np.pi * np.arange(FACES) / FACES
    aged = rng.normal(size=FACES)
    aged += float(rng.uniform(0.0, 0.7)) * np.cos(int(rng.integers(1, 6)) * at + any_phase(rng))
    tilt = bench.reference.polygon.pyramidal_arcsec
    wrong = aged + float(rng.uniform(0.0, 0.5)) * tilt / max(float(np.std(tilt)), 1e-9)
    wrong = wrong - wrong.mean()
    pattern = np.where(bench.reference.on_polygon, wrong[bench.reference.face], 0.0)
    return Defect(
        name="reference_artefact",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(reference_arcsec=size * pattern),
        cells=tuple(CellTruth(order=str(k), frame="polygon") for k in range(1, HIGHEST_ORDER + 1)),
        parameters={},
    )
