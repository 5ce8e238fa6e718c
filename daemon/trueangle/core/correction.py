"""The correction of all joints in one pass: `corrected = raw + correction`, in float64.

A model is anything with `correct`; the daemon gives it ONNX sessions, tests a formula.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import ARCSEC_PER_DEG, wrap_deg


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelAnswer:
    """What a model says of n samples."""

    correction_arcsec: NDArray[np.float64]
    """Shape [n]."""
    uncertainty_arcsec: NDArray[np.float64] | None
    """Shape [n], k = 1; None where the method has none."""


class CorrectionModel(Protocol):
    """One joint's model."""

    def correct(self, angle_deg: NDArray[np.float64], temperature_c: NDArray[np.float64]) -> ModelAnswer:
        """Corrections for n samples, shapes [n]."""
        ...


class Correction(NamedTuple):
    """The model's word on one sample; non-finite values are kept, `health` judges them."""

    correction_arcsec: float
    uncertainty_arcsec: float | None

    @property
    def known(self) -> "Correction":
        """The same, with an uncertainty that can be one: NaN and negative numbers say nothing."""
        uncertainty = self.uncertainty_arcsec
        return self if uncertainty is None or uncertainty >= 0.0 else Correction(self.correction_arcsec, None)

    def corrected_deg(self, raw_deg: float) -> float:
        """The corrected angle in [0, 360)."""
        return wrap_deg(raw_deg + self.correction_arcsec / ARCSEC_PER_DEG)


def correct_one(model: CorrectionModel, raw_deg: float, temperature_c: float) -> Correction:
    """One joint's correction from its model."""
    answer = model.correct(np.array([raw_deg]), np.array([temperature_c]))
    uncertainty = answer.uncertainty_arcsec
    return Correction(
        correction_arcsec=float(answer.correction_arcsec[0]),
        uncertainty_arcsec=None if uncertainty is None else float(uncertainty[0]),
    )


@runtime_checkable
class SampleModel(Protocol):
    """A model with a shorter way for one sample, which must give what `correct` gives for it."""

    def correct_sample(self, raw_deg: float, temperature_c: float) -> Correction:
        """The correction of one sample; NaN where the model could not be run."""
        ...


def one_sample(model: CorrectionModel) -> Callable[[float, float], Correction]:
    """The model's shortest way from one angle and temperature to its correction."""
    if isinstance(model, SampleModel):
        return model.correct_sample
    return lambda raw_deg, temperature_c: correct_one(model, raw_deg, temperature_c)
