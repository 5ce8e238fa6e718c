"""A few reference angles against a model: is it still good, and if not, why. No I/O here.

Rules of this file: differences are corrected - reference, in arcseconds, and are judged with the standard
uncertainty of each point (model and reference together). A cause is named only where taking it out leaves points
that are good; else the answer is that the model does not fit.
"""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.units import ARCSEC_PER_DEG, angle_difference_deg

Floats = NDArray[np.float64]
COVERAGE = 2.0
SINGLE_LIMIT = 1.5
"""|E_n| of one point, in units of U (k = 2): three standard uncertainties, passed by chance once in 370 points."""
CHI_SQUARED_Z = 2.326
"""Quantile 0.99 of the normal distribution: a good encoder is called bad once in a hundred verifications."""
FEWEST_FOR_CAUSE = 6
"""Offset and first harmonic take three of them; fewer leave too little to tell a cause from chance."""
HELPS_BELOW = 0.7
"""A correction that takes off less than 30 % of the error is not this joint's."""


class Verdict(enum.Enum):
    """The one line of a verification."""

    GOOD = "good: model, encoder and reference agree within their uncertainty"
    OFFSET = (
        "offset: all angles differ by the same amount - encoder re-seated or preset, or another reference zero"
    )
    RESEATED = "re-seated: an offset and a first harmonic remain - the encoder was mounted anew; calibrate again"
    WRONG_JOINT = "wrong joint: the correction does not make the angle better - the model is not this joint's"
    CHANGED = "changed: the model helps, but more remains than it states - calibrate again"
    NOT_GOOD = "not good: the angles differ by more than the uncertainty; more reference angles tell why"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferencePoint:
    """One reference angle and what was read there."""

    reference_deg: float
    raw_deg: float
    corrected_deg: float
    uncertainty_arcsec: float
    """Standard (k = 1) of corrected - reference, greater than 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """What the points say together."""

    verdict: Verdict
    differences_arcsec: tuple[float, ...]
    """corrected - reference, an unknown zero taken out where asked."""
    normalised: tuple[float, ...]
    """E_n of each point: difference / U with k = 2 (ISO 13528)."""
    offset_arcsec: float
    first_harmonic_arcsec: float
    """Amplitude; 0 where there are too few points."""
    raw_rms_arcsec: float
    """Of raw - reference about its mean."""
    corrected_rms_arcsec: float
    """Of corrected - reference about its mean."""


def combined_uncertainty(model_arcsec: float | None, reference_arcsec: float | None) -> float | None:
    """Root of the sum of squares; None where neither is known or both are 0."""
    known = [value for value in (model_arcsec, reference_arcsec) if value is not None]
    total = math.hypot(*known) if known else 0.0
    return total if total > 0 else None


def verify(points: Sequence[ReferencePoint], *, free_zero: bool) -> Verification:
    """Judge the points; `free_zero`: the reference has a zero of its own, so an offset says nothing.

    Raises ValueError without a point, or with a single one where its zero is free.
    """
    if len(points) < (2 if free_zero else 1):
        raise ValueError(f"points: expected at least {2 if free_zero else 1}, got {len(points)}")
    reference = np.array([point.reference_deg for point in points])
    corrected = _difference(np.array([point.corrected_deg for point in points]), reference)
    raw = _difference(np.array([point.raw_deg for point in points]), reference)
    sigma = np.array([point.uncertainty_arcsec for point in points])
    offset = _fit(corrected, sigma, _design(reference, harmonic=False))
    offset_arcsec = float(offset[0])
    left = _centred(corrected, offset_arcsec)
    judged = left if free_zero else corrected
    harmonic_arcsec = 0.0
    verdict = Verdict.GOOD
    spent = 1 if free_zero else 0
    if not _good(judged, sigma, spent):
        verdict = Verdict.NOT_GOOD
        if len(points) >= FEWEST_FOR_CAUSE:
            design = _design(reference, harmonic=True)
            fitted = _fit(left, sigma, design)
            harmonic_arcsec = float(np.hypot(fitted[1], fitted[2]))
            verdict = _cause(left, left - design @ fitted, raw, sigma, free_zero=free_zero)
        elif not free_zero and len(points) >= 3 and _good(left, sigma, 1):
            verdict = Verdict.OFFSET
    return Verification(
        verdict=verdict,
        differences_arcsec=tuple(judged.tolist()),
        normalised=tuple((judged / (COVERAGE * sigma)).tolist()),
        offset_arcsec=offset_arcsec,
        first_harmonic_arcsec=harmonic_arcsec,
        raw_rms_arcsec=_rms_about_mean(raw),
        corrected_rms_arcsec=_rms_about_mean(corrected),
    )


def _cause(left: Floats, rest: Floats, raw: Floats, sigma: Floats, *, free_zero: bool) -> Verdict:
    if not free_zero and _good(left, sigma, 1):
        return Verdict.OFFSET
    if _rms_about_mean(left) > HELPS_BELOW * _rms_about_mean(raw) and not _good(rest, sigma, 3):
        return Verdict.WRONG_JOINT
    return Verdict.RESEATED if _good(rest, sigma, 3) else Verdict.CHANGED


def _difference(angle_deg: Floats, reference_deg: Floats) -> Floats:
    return angle_difference_deg(angle_deg, reference_deg) * ARCSEC_PER_DEG


def _centred(values: Floats, offset: float) -> Floats:
    """Less the offset, by the shorter way round."""
    return angle_difference_deg(values / ARCSEC_PER_DEG, offset / ARCSEC_PER_DEG) * ARCSEC_PER_DEG


def _design(reference_deg: Floats, *, harmonic: bool) -> Floats:
    phase = np.deg2rad(reference_deg)
    ones = np.ones_like(phase)
    return np.column_stack([ones, np.cos(phase), np.sin(phase)] if harmonic else [ones])


def _fit(values: Floats, sigma: Floats, design: Floats) -> Floats:
    """Weighted least squares."""
    solved = np.linalg.lstsq(design / sigma[:, None], values / sigma, rcond=None)[0]
    return np.asarray(solved, dtype=np.float64)


def _good(values: Floats, sigma: Floats, spent: int) -> bool:
    """No point beyond its limit, and all together no more than chance gives (chi-squared, 0.99).

    The quantile is that of Wilson and Hilferty (1931), within 1 % from one degree of freedom on at this level.
    """
    freedom = values.size - spent
    if freedom < 1:
        return False
    ratio = values / sigma
    part = 2.0 / (9.0 * freedom)
    limit = freedom * (1.0 - part + CHI_SQUARED_Z * math.sqrt(part)) ** 3
    return bool(np.all(np.abs(ratio) <= COVERAGE * SINGLE_LIMIT) and float(ratio @ ratio) <= limit)


def _rms_about_mean(values: Floats) -> float:
    return float(np.sqrt(np.mean((values - np.mean(values)) ** 2)))
