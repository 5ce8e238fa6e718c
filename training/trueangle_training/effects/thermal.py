"""Errors that follow the joint's temperature: differential expansion moves and deforms the grating."""

from dataclasses import dataclass
from typing import Annotated

from trueangle.contract.document import Range
from trueangle.contract.joint import Joint
from trueangle_training.effects.harmonics import MAX_ORDER, HarmonicTerm, Order
from trueangle_training.effects.kinds import (
    Amplitude,
    Degree,
    EffectKind,
    Phase,
    both_or_neither,
    check_harmonics,
    check_orders,
    linear_only,
    order_span,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _OneOrder:
    """Drift of one order with temperature; amplitude and phase left out: calibrated from data."""

    amplitude_arcsec_per_k: Amplitude | None = None
    phase_deg: Phase | None = None
    degree: Degree = 1
    """Highest power of the temperature difference that is modelled."""

    def __post_init__(self) -> None:
        both_or_neither("amplitude_arcsec_per_k", self.amplitude_arcsec_per_k, "phase_deg", self.phase_deg)

    def at_order(self, order: int) -> tuple[HarmonicTerm, ...] | None:
        """The linear term."""
        if self.amplitude_arcsec_per_k is None or self.phase_deg is None:
            return None
        linear_only(self.degree)
        amplitude = self.amplitude_arcsec_per_k
        return (HarmonicTerm(order=order, degree=1, amplitude=amplitude, phase_deg=self.phase_deg),)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalEccentricitySettings(_OneOrder):
    """Differential expansion of shaft, sleeve and mounting plate moves the grating centre."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """Order 1."""
        return self.at_order(1)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalTiltSettings(_OneOrder):
    """Tilt or ovality that grows with temperature."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """Order 2."""
        return self.at_order(2)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalHarmonic:
    """One order of the graduation's drift."""

    order: Annotated[int, Range(minimum=3, maximum=MAX_ORDER)]
    amplitude_arcsec_per_k: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalGraduationSettings:
    """Long-range graduation error that grows with temperature: orders from 3."""

    orders: tuple[int, int] | None = None
    """First and last order, both modelled; None: 3 to min(11, (faces - 1) // 2)."""
    degree: Degree = 1
    harmonics: tuple[ThermalHarmonic, ...] | None = None
    """None: calibrated from data; an order that is not listed has no drift."""

    def __post_init__(self) -> None:
        check_orders(self.orders, minimum=3)

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """One linear term for each order listed."""
        if self.harmonics is None:
            return None
        linear_only(self.degree)
        check_harmonics([h.order for h in self.harmonics], span=order_span(self.orders, joint.reference.faces))
        return tuple(
            HarmonicTerm(order=h.order, degree=1, amplitude=h.amplitude_arcsec_per_k, phase_deg=h.phase_deg)
            for h in self.harmonics
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadraticHarmonic:
    """One order of the quadratic drift."""

    order: Order
    amplitude_arcsec_per_k2: Amplitude
    phase_deg: Phase


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalNonlinearitySettings:
    """The part of the drift that goes with the square of the temperature difference."""

    harmonics: tuple[QuadraticHarmonic, ...] | None = None
    """None: calibrated from data; an order that is not listed has no quadratic drift."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """One quadratic term for each order listed."""
        if self.harmonics is None:
            return None
        check_harmonics([h.order for h in self.harmonics], span=(1, MAX_ORDER))
        return tuple(
            HarmonicTerm(order=h.order, degree=2, amplitude=h.amplitude_arcsec_per_k2, phase_deg=h.phase_deg)
            for h in self.harmonics
        )


THERMAL_ECCENTRICITY = EffectKind(name="thermal_eccentricity", settings=ThermalEccentricitySettings)
THERMAL_TILT = EffectKind(name="thermal_tilt", settings=ThermalTiltSettings)
THERMAL_GRADUATION = EffectKind(name="thermal_graduation", settings=ThermalGraduationSettings)
THERMAL_NONLINEARITY = EffectKind(name="thermal_nonlinearity", settings=ThermalNonlinearitySettings)
