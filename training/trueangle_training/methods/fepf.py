"""FEPF: Fourier series whose coefficients are polynomials of temperature, eqs. (13)-(14) of Jia et al. 2020.

The paper fits a series at each temperature, then a polynomial through each coefficient. Where every face was read
equally often at every temperature, one least squares over all readings gives the same coefficients.
"""

from dataclasses import dataclass

from trueangle_training.methods import Fit, Progress, TrainingReadings, no_progress
from trueangle_training.methods.least_squares import Constant, fit_harmonics_times_powers


@dataclass(frozen=True, slots=True, kw_only=True)
class Fepf:
    """The `Method` of the paper's section 4.3.2."""

    order: int = 7
    degree: int = 5
    name: str = "fepf"
    summary: str = "harmonics 0-7 with coefficients of degree 5 in T, eqs. (13)-(14)"

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Least squares; deterministic, the seed changes nothing."""
        fitted = fit_harmonics_times_powers(
            readings, order=self.order, degree=self.degree, constant=Constant.POLYNOMIAL
        )
        return Fit(model=fitted.model, settings={"order": self.order, "degree": self.degree})


def make(base_temperature_c: float) -> Fepf:
    """The paper's settings; no base temperature is needed."""
    return Fepf()
