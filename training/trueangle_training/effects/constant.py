"""Errors that do not change with temperature: the grating and how it sits on the shaft."""

from dataclasses import dataclass
from typing import Annotated

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle_training.effects.harmonics import MAX_ORDER, HarmonicTerm
from trueangle_training.effects.kinds import (
    Amplitude,
    EffectKind,
    Phase,
    both_or_neither,
    check_harmonics,
    check_orders,
    order_span,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _OneOrder:
    """Amplitude and phase of one order; both left out: calibrated from data."""

    amplitude_arcsec: Amplitude | None = None
    phase_deg: Phase | None = None

    def __post_init__(self) -> None:
        both_or_neither("amplitude_arcsec", self.amplitude_arcsec, "phase_deg", self.phase_deg)

    def at_order(self, order: int) -> tuple[HarmonicTerm, ...] | None:
        """The only term."""
        if self.amplitude_arcsec is None or self.phase_deg is None:
            return None
        term = HarmonicTerm(order=order, degree=0, amplitude=self.amplitude_arcsec, phase_deg=self.phase_deg)
        return (term,)


@dataclass(frozen=True, slots=True, kw_only=True)
class EccentricitySettings(_OneOrder):
    """Grating centre off the axis: with a reading head at radius r, e / r radians, once a turn."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """Order 1."""
        return self.at_order(1)


@dataclass(frozen=True, slots=True, kw_only=True)
class GratingTiltSettings(_OneOrder):
    """Tilt or ovality of the grating: twice a turn."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """Order 2."""
        return self.at_order(2)


@dataclass(frozen=True, slots=True, kw_only=True)
class GraduationHarmonic:
    """One order of the long-range graduation error."""

    order: Annotated[int, Range(minimum=3, maximum=MAX_ORDER)]
    amplitude_arcsec: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class GraduationErrorSettings:
    """Long-range graduation error: orders from 3."""

    orders: tuple[int, int] | None = None
    """First and last order, both modelled; None: 3 to min(11, (faces - 1) // 2)."""
    harmonics: tuple[GraduationHarmonic, ...] | None = None
    """None: calibrated from data; an order that is not listed has no error."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=3)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """One term for each order listed."""
        if self.harmonics is None:
            return None
        check_harmonics([h.order for h in self.harmonics], span=order_span(self.orders, joint.reference.faces))
        return tuple(
            HarmonicTerm(order=h.order, degree=0, amplitude=h.amplitude_arcsec, phase_deg=h.phase_deg)
            for h in self.harmonics
        )


ECCENTRICITY = EffectKind(name="eccentricity", settings=EccentricitySettings)
GRATING_TILT = EffectKind(name="grating_tilt", settings=GratingTiltSettings)
GRADUATION_ERROR = EffectKind(name="graduation_error", settings=GraduationErrorSettings)
