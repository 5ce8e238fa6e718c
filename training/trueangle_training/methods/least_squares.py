"""Harmonics of the angle times powers of the temperature by plain least squares: the paper's and older methods."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import Fault
from trueangle.contract.units import wrap_deg
from trueangle_training.methods import TrainingReadings, UnsuitableReadingsError, distinct_angle_count
from trueangle_training.methods.separable import SeparableModel, TemperatureBasis, harmonics

Floats = NDArray[np.float64]

SAME_TEMPERATURE_C = 1.0
"""Runs whose means lie this close together are runs at one temperature."""


class Constant(Enum):
    """What stands for the part of the readings that does not depend on the angle."""

    POLYNOMIAL = "a polynomial of temperature"
    """f_a0(T) of eq. (14)."""
    OFFSETS = "an offset for each zero group"
    """The noise of the first reading, which eq. (11) puts into the whole run, is then no error of the model."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeastSquaresFit:
    """A model and the readings' values under it, its constant included."""

    model: SeparableModel
    fitted_arcsec: Floats
    """[readings]"""


def distinct_temperature_count(readings: TrainingReadings) -> int:
    """How many temperatures were measured: groups of run means, more than `SAME_TEMPERATURE_C` apart."""
    ordered = np.unique(readings.run_mean_temperature_c())
    return int(np.count_nonzero(np.diff(ordered) > SAME_TEMPERATURE_C)) + 1


def fit_harmonics_times_powers(
    readings: TrainingReadings, *, order: int, degree: int, constant: Constant
) -> LeastSquaresFit:
    """Least squares over all readings; UnsuitableReadingsError where they do not determine the coefficients."""
    _check(readings, order, degree)
    orders = tuple(range(1, order + 1))
    lowest_c, highest_c = float(readings.temperature_c.min()), float(readings.temperature_c.max())
    basis = TemperatureBasis(
        centre_c=(lowest_c + highest_c) / 2,
        scale_c=(highest_c - lowest_c) / 2 or 1.0,
        powers=tuple(range(degree + 1)),
    )
    powers = basis.evaluate(readings.temperature_c)
    by_angle = harmonics(wrap_deg(readings.angle_deg), orders)
    products = (powers[:, :, None] * by_angle[:, None, :]).reshape(len(readings), -1)
    if constant is Constant.POLYNOMIAL:
        level = powers
    else:
        groups = readings.offset_group
        level = np.eye(int(groups.max()) + 1)[groups]
    design = np.concatenate([products, level], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(design, readings.error_arcsec, rcond=None)
    if rank < design.shape[1]:
        raise UnsuitableReadingsError(
            [
                Fault(
                    where="readings",
                    expected=f"angles and temperatures that determine {design.shape[1]} coefficients",
                    found=f"{len(readings)} readings that determine {rank}",
                    advice="measure every angle at every temperature, or ask for a lower order",
                )
            ]
        )
    model = SeparableModel(
        orders=orders,
        basis=basis,
        weights_arcsec=solution[: products.shape[1]].reshape(basis.size, -1).astype(np.float64),
        datum_deg=readings.datum_deg,
        temperature_used=degree > 0,
    )
    return LeastSquaresFit(model=model, fitted_arcsec=design @ solution)


def _check(readings: TrainingReadings, order: int, degree: int) -> None:
    faults: list[Fault] = []
    places = distinct_angle_count(readings.angle_deg)
    if places < 2 * order + 1:
        expected = f"at least {2 * order + 1} distinct angles for harmonics up to {order}"
        advice = "measure more angles, or choose another method"
        faults.append(Fault(where="angle_deg", expected=expected, found=str(places), advice=advice))
    temperatures = distinct_temperature_count(readings)
    if temperatures < degree + 1:
        expected = f"at least {degree + 1} temperatures for coefficients of degree {degree}"
        advice = "measure at more temperatures, or choose another method"
        faults.append(Fault(where="temperature_c", expected=expected, found=str(temperatures), advice=advice))
    if faults:
        raise UnsuitableReadingsError(faults)
