"""From torques, displacements and temperatures to what encoder and reference say."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.conditions import Conditions
from trueangle_training.plant.mechanical.geometry import head_error_arcsec
from trueangle_training.plant.mechanical.joint_heat import JointHeat

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Vectors = NDArray[np.complexfloating[Any, Any]] | NDArray[np.float64] | complex

DRIVE_RIPPLE = 0.008
"""Of the speed, with the teeth of the drive's belt."""
BELT_TEETH = 9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Share:
    """One cause's share in the chain; arrays have shape [n] and are broadcast from scalars."""

    twist_arcsec: Floats | float = 0.0
    """Of the grating's end of the shaft against the polygon's."""
    index_arcsec: Floats | float = 0.0
    """The head along the track."""
    centre_arcsec: Vectors = 0.0
    """Grating's centre in the shaft's frame, over the radius."""
    axis_arcsec: Vectors = 0.0
    """The shaft's axis in the housing's frame, over the radius."""
    oval_arcsec: Vectors = 0.0
    track_arcsec: Floats | float = 0.0
    """Lines away from their places."""
    late_s: float = 0.0
    """By how much the encoder is read late."""
    scatter_arcsec: Floats | float = 0.0
    """Standard deviation of additional scatter."""
    bias_c: float = 0.0
    gain: float = 1.0
    """Of the temperature sensor."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stand:
    """All that a cause can depend on."""

    conditions: Conditions
    heat: JointHeat

    @property
    def angle_rad(self) -> Floats:
        """True shaft angle at the readings, shape [n]."""
        return np.deg2rad(self.conditions.schedule.angle_deg)


def error_arcsec(stand: Stand, shares: Sequence[Share]) -> Floats:
    """Indicated minus reference without noise and rounding, shape [n]."""
    schedule = stand.conditions.schedule
    shape = schedule.angle_deg.shape
    ripple = 1.0 + DRIVE_RIPPLE * np.cos(BELT_TEETH * stand.angle_rad)
    late = sum(share.late_s for share in shares) * schedule.velocity_deg_s * ripple * 3600.0
    turned = _sum([share.twist_arcsec for share in shares], shape) - late
    head = head_error_arcsec(
        schedule.angle_deg + turned / 3600.0,
        centre_arcsec=_sum_vectors([share.centre_arcsec for share in shares], shape),
        axis_arcsec=_sum_vectors([share.axis_arcsec for share in shares], shape),
        oval_arcsec=_sum_vectors([share.oval_arcsec for share in shares], shape),
    )
    along = _sum([share.index_arcsec for share in shares], shape)
    return turned + head + along + _sum([share.track_arcsec for share in shares], shape)


def scatter_arcsec(stand: Stand, shares: Sequence[Share]) -> Floats:
    """Standard deviation that causes add to each reading, shape [n]."""
    shape = stand.conditions.schedule.angle_deg.shape
    return np.sqrt(_sum([np.square(share.scatter_arcsec) for share in shares], shape))


def _sum(values: Sequence[Floats | float], shape: tuple[int, ...]) -> Floats:
    total = np.zeros(shape)
    for value in values:
        total = total + np.asarray(value, dtype=np.float64)
    return total


def _sum_vectors(values: Sequence[Vectors], shape: tuple[int, ...]) -> Complexes:
    total = np.zeros(shape, dtype=np.complex128)
    for value in values:
        total = total + np.asarray(value, dtype=np.complex128)
    return total


def phasor(rng: np.random.Generator) -> complex:
    """Any direction, length 1."""
    return complex(np.exp(1j * float(rng.uniform(0.0, 2.0 * np.pi))))
