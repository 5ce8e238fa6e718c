"""The noise of one reading, and whence it is known."""

from dataclasses import dataclass

from trueangle_training.evaluation.held_out import repeatability_arcsec
from trueangle_training.methods import TrainingReadings, UnsuitableReadingsError
from trueangle_training.methods.coefficients import reduce_to_coefficients

FAR_ABOVE_NOISE = 2.0
"""Left-out error over the noise of a reading: a sound method on a smooth joint is at 1.0 to 1.3, at 2 most of what
is left is the method's or the data's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingNoise:
    """Standard deviation of one reading."""

    sigma_arcsec: float
    from_repeats: bool
    """False: from what a smooth fit leaves, as shifted repeats never read a place twice."""


def reading_noise(readings: TrainingReadings) -> ReadingNoise | None:
    """From repeats of a place, which need no model; else that of the fit. None: neither is to be had."""
    repeated = repeatability_arcsec(readings)
    if repeated is not None:
        return ReadingNoise(sigma_arcsec=repeated, from_repeats=True)
    try:
        return ReadingNoise(sigma_arcsec=reduce_to_coefficients(readings).sigma_arcsec, from_repeats=False)
    except UnsuitableReadingsError:
        return None


def held_out_caution(rmse_arcsec: float, noise_arcsec: float | None) -> str | None:
    """Where left-out temperatures are predicted far worse than a reading scatters; None: they are not."""
    if noise_arcsec is None or rmse_arcsec <= FAR_ABOVE_NOISE * noise_arcsec:
        return None
    return (
        f"left-out temperatures are {rmse_arcsec / noise_arcsec:.1f} times farther off than a reading scatters "
        f"({rmse_arcsec:.2f} over {noise_arcsec:.2f} arcsec), and so may be the correction between temperatures. "
        "Are all temperatures right and in degC? Else compare methods (trueangle compare) or measure more of them"
    )
