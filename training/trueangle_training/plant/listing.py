"""Which effects JOINT.yaml lists, and the label of the encoder: drawn alike in all plants and for all cases."""

from dataclasses import dataclass

import numpy as np

GRATINGS = ((5000, 1024), (9000, 400), (11840, 512), (16384, 200), (18000, 256))
"""Lines a turn and interpolation."""
TURN_ARCSEC = 1_296_000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoder:
    """What stands on its label."""

    lines_per_rev: int
    counts_per_rev: int

    @property
    def count_arcsec(self) -> float:
        """One count."""
        return TURN_ARCSEC / self.counts_per_rev


def draw_encoder(rng: np.random.Generator) -> Encoder:
    """One of some usual gratings."""
    lines, interpolation = GRATINGS[int(rng.integers(len(GRATINGS)))]
    return Encoder(lines_per_rev=lines, counts_per_rev=lines * interpolation)


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """The effects that JOINT.yaml lists, as orders."""

    constant: tuple[int, ...]
    thermal: tuple[int, ...]


def draw_listing(rng: np.random.Generator) -> Listing:
    """Which effects the simulator models: drawn alike for all kinds of cases."""
    constant = [1] * (rng.random() < 0.85) + [2] * (rng.random() < 0.75)
    graduation = rng.random()
    if graduation < 0.45:
        constant += range(3, int(rng.integers(4, 9)))
    elif graduation < 0.65:
        constant += range(3, 12)
    thermal = [1] * (rng.random() < 0.75) + [2] * (rng.random() < 0.25)
    return Listing(constant=tuple(constant), thermal=tuple(thermal))


def without(listing: Listing, name: str) -> Listing:
    """The listing when this effect is the one that the simulator lacks."""
    constant, thermal = listing.constant, listing.thermal
    gone = {"eccentricity": 1, "grating_tilt": 2}.get(name)
    if name == "graduation_error" and len(constant) > 8:
        constant = tuple(k for k in constant if k <= 5)
    if name == "temperature_sensor_error":
        # With both listed, a sensor that is wrong by bias and gain only changes their parameters.
        thermal = thermal or (1,)
        constant = tuple(sorted({*constant, *thermal}))
    hot = {"thermal_eccentricity": 1, "thermal_tilt": 2}.get(name)
    return Listing(constant=tuple(k for k in constant if k != gone), thermal=tuple(k for k in thermal if k != hot))
