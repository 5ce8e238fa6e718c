"""Dirt, a scratch, a missing line: an error in a window of angle."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import SignedAmplitude
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter
from trueangle_training.effects.harmonics import MAX_ORDER, HarmonicTerm
from trueangle_training.effects.patterns import beside, distinct_places, no_columns

Floats = NDArray[np.float64]

SIGMAS_PER_FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))
SEARCHED_FWHM_DEG = (3.0, 6.0, 12.0)
MANY_PLACES = 90
_SLOPE_SIZE = 0.5
_SPECTRUM_ENDS_SIGMAS = 6.0
_STEP_WIDTHS = 0.75


@dataclass(frozen=True, slots=True, kw_only=True)
class Defect:
    """One Gaussian bump."""

    centre_deg: Annotated[float, Range(minimum=-360, maximum=360)]
    fwhm_deg: Annotated[float, Range(minimum=1, maximum=15)]
    """Full width at half maximum."""
    amplitude_arcsec: SignedAmplitude
    """Height over what the turn is elsewhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizedDefectSettings:
    """Bumps, each counted from its mean over the turn, which no campaign shows."""

    defects: tuple[Defect, ...] | None = None
    """None: not modelled, as no calibration can start without a place."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """The Fourier series of a Gaussian that is wrapped round the turn, but for 1e-8 of its height."""
        if self.defects is None:
            return None
        return tuple(term for defect in self.defects for term in _spectrum(defect))

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`."""
        total = np.zeros(len(conditions))
        for defect in self.defects or ():
            total += defect.amplitude_arcsec * bump(conditions.angle_deg, defect.centre_deg, defect.fwhm_deg)
        return total

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """Each bump and how it changes with its place and its width."""
        angle_deg = conditions.angle_deg
        blocks = [
            beside(
                bump(angle_deg, defect.centre_deg, defect.fwhm_deg),
                _slope(angle_deg, defect.centre_deg, defect.fwhm_deg),
                _widening(angle_deg, defect.centre_deg, defect.fwhm_deg),
            )
            for defect in self.defects or ()
        ]
        return beside(no_columns(len(conditions)), *blocks)


def _spectrum(defect: Defect) -> Iterator[HarmonicTerm]:
    sigma_rad = math.radians(defect.fwhm_deg / SIGMAS_PER_FWHM)
    last = min(math.ceil(_SPECTRUM_ENDS_SIGMAS / sigma_rad), MAX_ORDER)
    flip_deg = 180.0 if defect.amplitude_arcsec < 0 else 0.0
    for order in range(1, last + 1):
        share = 2.0 * sigma_rad / math.sqrt(2.0 * math.pi) * math.exp(-((order * sigma_rad) ** 2) / 2.0)
        yield HarmonicTerm(
            order=order,
            degree=0,
            amplitude=abs(defect.amplitude_arcsec) * share,
            phase_deg=math.fmod(order * defect.centre_deg, DEG_PER_TURN) + flip_deg,
        )


def _from_centre_sigmas(angle_deg: Floats, centre_deg: float, fwhm_deg: float) -> Floats:
    from_centre_deg = np.mod(angle_deg - centre_deg + DEG_PER_TURN / 2, DEG_PER_TURN) - DEG_PER_TURN / 2
    return from_centre_deg * (SIGMAS_PER_FWHM / fwhm_deg)


def bump(angle_deg: Floats, centre_deg: float, fwhm_deg: float) -> Floats:
    """A Gaussian of height 1, less its mean over the turn, shape [readings]."""
    mean = fwhm_deg / SIGMAS_PER_FWHM * math.sqrt(2.0 * math.pi) / DEG_PER_TURN
    return np.exp(-(_from_centre_sigmas(angle_deg, centre_deg, fwhm_deg) ** 2) / 2.0) - mean


def _slope(angle_deg: Floats, centre_deg: float, fwhm_deg: float) -> Floats:
    """The bump's change with its place, in heights per sigma."""
    sigmas = _from_centre_sigmas(angle_deg, centre_deg, fwhm_deg)
    return sigmas * np.exp(-(sigmas**2) / 2.0)


def _widening(angle_deg: Floats, centre_deg: float, fwhm_deg: float) -> Floats:
    """The bump's change with its width, for a width e times as large."""
    sigmas = _from_centre_sigmas(angle_deg, centre_deg, fwhm_deg)
    return sigmas**2 * np.exp(-(sigmas**2) / 2.0)


def searched_windows(angle_deg: Floats) -> Iterator[tuple[float, float]]:
    """Centre and width of the bumps that the measured places tell apart."""
    places_deg = distinct_places(angle_deg)
    if places_deg.size > MANY_PLACES:
        for fwhm_deg in SEARCHED_FWHM_DEG:
            count = round(DEG_PER_TURN / (fwhm_deg * _STEP_WIDTHS))
            for k in range(count):
                centre_deg = k * DEG_PER_TURN / count
                nearest = np.abs(_from_centre_sigmas(places_deg, centre_deg, fwhm_deg)).min()
                if nearest < 1.0:
                    yield centre_deg, fwhm_deg
        return
    # Places further apart than a bump is wide: each width shows one place or, from between two, both.
    after_deg = np.diff(places_deg, append=places_deg[:1] + DEG_PER_TURN)
    for place_deg, gap_deg in zip(places_deg.tolist(), after_deg.tolist(), strict=True):
        yield place_deg, SEARCHED_FWHM_DEG[1]
        if gap_deg < 2 * SEARCHED_FWHM_DEG[-1]:
            yield math.fmod(place_deg + gap_deg / 2, DEG_PER_TURN), SEARCHED_FWHM_DEG[-1]


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Bumps round the turn."""
    for centre_deg, fwhm_deg in searched_windows(conditions.angle_deg):
        yield Hypothesis(
            effect="localized_defect",
            label=f"{fwhm_deg:g} deg wide at {centre_deg:.1f} deg",
            cell=Cell(order="localized"),
            main=bump(conditions.angle_deg, centre_deg, fwhm_deg)[:, None],
            coefficients=("amplitude_arcsec",),
            wiggle=beside(
                _slope(conditions.angle_deg, centre_deg, fwhm_deg),
                _widening(conditions.angle_deg, centre_deg, fwhm_deg),
            ),
            wiggle_size=_SLOPE_SIZE,
            shape={"centre_deg": centre_deg, "fwhm_deg": fwhm_deg},
        )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """Place, width and height."""
    return {"defects": [{**hypothesis.shape, "amplitude_arcsec": float(coefficients[0])}]}


EFFECT = LibraryEffect(
    name="localized_defect",
    nature=Nature.MEAN,
    physics="Dirt, a scratch or a missing line disturbs the reading where it passes the head.",
    formula="E = A exp(-(θ - c)² / 2s²), full width at half maximum 2.355 s <= 15 deg",
    source="shop experience; the window of the reading head averages over its length",
    parameters=(
        Parameter(name="amplitude_arcsec", unit="arcsec", low=-50.0, high=50.0, source="shop experience"),
        Parameter(name="centre_deg", unit="deg", low=0.0, high=360.0, source="anywhere"),
        Parameter(
            name="fwhm_deg",
            unit="deg",
            low=1.0,
            high=15.0,
            source="length of reading heads: 5 to 30 mm on the ring",
        ),
    ),
    cells=(Cell(order="localized"),),
    proof="Read every half degree about the place, clean the grating there, read again.",
    missing_input=None,
    settings=LocalizedDefectSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
)
