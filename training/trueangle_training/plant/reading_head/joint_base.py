"""The joint as its maker knows it: the effects that JOINT.yaml lists are there, with the sizes that they have."""

from dataclasses import dataclass

import numpy as np

from trueangle_training.plant.listing import Encoder, Listing
from trueangle_training.plant.reading_head.contribution import Contribution, Setting, together
from trueangle_training.plant.reading_head.geometry import ARCSEC_PER_RAD, SignalError
from trueangle_training.plant.reading_head.grating_defects import phase, ruled_wave
from trueangle_training.plant.reading_head.heat import Climate
from trueangle_training.plant.reading_head.thermal_defects import warming
from trueangle_training.plant.schedule import Floats, Schedule


def draw_setting(schedule: Schedule, climate: Climate, encoder: Encoder, rng: np.random.Generator) -> Setting:
    """The encoder on this shaft in this campaign."""
    return Setting(
        schedule=schedule,
        climate=climate,
        radius_mm=float(rng.uniform(20.0, 60.0)),
        lines_per_rev=encoder.lines_per_rev,
        count_arcsec=360.0 * 3600.0 / encoder.counts_per_rev,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BaseSizes:
    """Sizes and phases of every effect that may be listed; drawn whether it is listed or not."""

    constant: dict[int, tuple[float, float]]
    thermal: dict[int, tuple[float, float]]
    drift_arcsec_per_k: float
    signals: SignalError


def draw_base(rng: np.random.Generator) -> BaseSizes:
    """Usual amplitudes."""
    amplitude = {1: float(rng.uniform(20.0, 80.0)), 2: float(rng.uniform(2.0, 10.0))}
    amplitude |= {k: float(rng.uniform(0.1, 4.0)) * 2.0 / k for k in range(3, 12)}
    hot = {1: float(rng.uniform(2.0, 8.0)), 2: float(rng.uniform(0.3, 2.0))}
    return BaseSizes(
        constant={k: (size, phase(rng)) for k, size in amplitude.items()},
        thermal={k: (size, phase(rng)) for k, size in hot.items()},
        drift_arcsec_per_k=float(rng.normal(0.0, 0.1)),
        signals=SignalError(
            offset_cos=float(rng.normal(0, 2e-4)),
            offset_sin=float(rng.normal(0, 2e-4)),
            gain=float(rng.normal(0, 2e-4)),
            quadrature_rad=float(rng.normal(0, 2e-4)),
        ),
    )


def base_contribution(setting: Setting, base: BaseSizes, listing: Listing) -> Contribution:
    """Everything that is listed, the datum's drift, and an excellent pair of signals."""
    parts = [
        Contribution(
            head_arcsec=base.drift_arcsec_per_k * (setting.climate.temperature_c - 20.0), signals=base.signals
        )
    ]
    parts += [_order(setting, k, base.constant[k], 1.0) for k in listing.constant]
    parts += [_order(setting, k, base.thermal[k], warming(setting)) for k in listing.thermal]
    return together(parts)


def _order(
    setting: Setting, order: int, size_and_phase: tuple[float, float], course: Floats | float
) -> Contribution:
    size, at = size_and_phase
    if order == 1:
        return Contribution(centre_mm=setting.mm(size) * np.exp(1j * at) * course)
    if order == 2:
        return Contribution(ovality=2.0 * size / ARCSEC_PER_RAD * np.exp(1j * at) * course)
    return Contribution(
        line_shifts=(lambda place: size * course * ruled_wave(place, order=order, phase_rad=at, skew=1e-3),)
    )
