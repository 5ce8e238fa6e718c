"""How far the explanation truly closes the gap: from the truth, once the seal is open."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.blind_check.answers import loaded
from trueangle_training.diagnosis.problem import problem_of

Floats = NDArray[np.float64]


def true_closure_of(
    measured_csv: str, joint_yaml: str, *, truth_arcsec: Floats, explained_arcsec: Floats | None
) -> float | None:
    """1 - |(f - e) outside the span|^2 / |f outside it|^2: f the true structure, e what was found.

    The span is what re-calibration takes up: offsets, drift, listed effects. None: there is no structure, nothing
    was fitted, or the diagnosis read other rows than were written.
    """
    if explained_arcsec is None or not truth_arcsec.any():
        return None
    problem = problem_of(*loaded(measured_csv, joint_yaml), library={})
    if not truth_arcsec.size == explained_arcsec.size == len(problem):
        return None
    nuisance = problem.nuisance()
    basis, values, _ = np.linalg.svd(nuisance / np.linalg.norm(nuisance, axis=0).clip(1e-300), full_matrices=False)
    basis = basis[:, values > 1e-9 * values[0]]
    seen, rest = (each - basis @ (basis.T @ each) for each in (truth_arcsec, truth_arcsec - explained_arcsec))
    return 1.0 - float(rest @ rest) / float(seen @ seen)
