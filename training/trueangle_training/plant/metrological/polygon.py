"""The reference: a polygon with a certificate, an autocollimator, and how both were set up."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.schedule import FACES, PITCH_DEG, Schedule

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polygon:
    """Faces as they are and as they are certified, shape [faces]."""

    place_arcsec: Floats
    """Of a face's normal against its nominal angle."""
    certified_arcsec: Floats
    pyramidal_arcsec: Floats
    """Tilt of a face towards the axis."""
    bend_arcsec_per_mm: Floats
    """Change of a face's direction along its width: it is not quite flat."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetUp:
    """What the operator adjusted, shape [n] as it holds at each reading."""

    centring_mm: NDArray[np.complex128]
    """Polygon's centre off the axis, in the shaft's frame; another one in each mounting."""
    roll_rad: Floats
    """Of the autocollimator's cross hair against the plane of rotation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Autocollimator:
    """Departures of its reading from the angle."""

    gain: float
    cubic_arcsec: float
    """Distortion of the lens at an arcminute."""
    fringe_arcsec: float
    """Amplitude of the interpolation between lines of its detector."""
    fringe_period_arcsec: float

    def excess_arcsec(self, angle_arcsec: Floats) -> Floats:
        """Reading less angle, shape [n]."""
        bent = self.cubic_arcsec * (angle_arcsec / 60.0) ** 3
        fringe = self.fringe_arcsec * np.sin(2.0 * np.pi * angle_arcsec / self.fringe_period_arcsec)
        return self.gain * angle_arcsec + bent + fringe


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """All of it in one campaign; what is of no polygon belongs to a reference encoder."""

    polygon: Polygon
    set_up: SetUp
    autocollimator: Autocollimator
    two_heads_arcsec: float
    """What two opposite heads leave of the reference encoder's error, twice a turn."""
    on_polygon: NDArray[np.bool_]
    """[n]"""
    face: Integers
    """[n], 0 to faces - 1; of readings without a polygon 0."""
    beside_arcsec: Floats
    """[n], how far the shaft stood beside the face's nominal angle."""

    def normal_arcsec(self, schedule: Schedule) -> Floats:
        """Angle that the autocollimator is offered, shape [n]: turn beside, face's place, and its bend."""
        facing = np.exp(1j * np.deg2rad(schedule.angle_deg))
        aside_mm = (self.set_up.centring_mm * facing).imag
        bend = self.polygon.bend_arcsec_per_mm[self.face] * aside_mm
        return self.beside_arcsec + self.polygon.place_arcsec[self.face] + bend

    def error_arcsec(self, schedule: Schedule) -> Floats:
        """What the reference says less the shaft's angle, without noise, shape [n]."""
        offered = self.normal_arcsec(schedule)
        crossed = self.polygon.pyramidal_arcsec[self.face] * self.set_up.roll_rad
        read = offered + self.autocollimator.excess_arcsec(offered) + crossed
        polygon = read - self.polygon.certified_arcsec[self.face] - self.beside_arcsec
        encoder = self.two_heads_arcsec * np.sin(2.0 * np.deg2rad(schedule.angle_deg))
        return np.where(self.on_polygon, polygon, encoder)

    def rolled(self, roll_rad: float) -> "Reference":
        """The same with the autocollimator turned about its axis."""
        return replace(self, set_up=replace(self.set_up, roll_rad=self.set_up.roll_rad + roll_rad))


def lapped_faces(rng: np.random.Generator, *, size_arcsec: float) -> Floats:
    """Places of faces [faces], mean 0, RMS as asked: lapping leaves low orders, hand work each face its own."""
    at = 2.0 * np.pi * np.arange(FACES) / FACES
    orders = rng.choice(np.arange(1, 6), size=2, replace=False)
    waves = sum((np.cos(int(k) * at + rng.uniform(0.0, 2.0 * np.pi)) for k in orders), np.zeros(FACES))
    places = waves + rng.normal(size=FACES)
    places = places - places.mean()
    return places * size_arcsec / float(np.sqrt(np.mean(places**2)))


def draw_reference(schedule: Schedule, rng: np.random.Generator) -> Reference:
    """A good polygon, fresh from calibration, and a careful operator: a few hundredths of an arcsecond in all."""
    places = lapped_faces(rng, size_arcsec=float(rng.uniform(0.3, 3.0)))
    polygon = Polygon(
        place_arcsec=places,
        certified_arcsec=places + rng.normal(0.0, 0.003, size=FACES),
        pyramidal_arcsec=rng.normal(0.0, 3.0, size=FACES),
        bend_arcsec_per_mm=rng.normal(0.0, 0.1, size=FACES),
    )
    mountings, which = np.unique(mounting(schedule), return_inverse=True)
    centring = 0.01 * (rng.normal(size=mountings.size) + 1j * rng.normal(size=mountings.size))
    nominal_deg = (schedule.face - 1 - schedule.polygon_offset) * PITCH_DEG
    beside_deg = schedule.angle_deg - nominal_deg
    on_polygon = schedule.face > 0
    mount = np.angle(np.mean(np.exp(1j * np.deg2rad(beside_deg[on_polygon]))))
    beside_rad = np.angle(np.exp(1j * (np.deg2rad(beside_deg) - mount)))
    return Reference(
        polygon=polygon,
        set_up=SetUp(centring_mm=centring[which], roll_rad=rng.normal(0.0, 5e-4, size=mountings.size)[which]),
        autocollimator=Autocollimator(
            gain=float(rng.normal(0.0, 1e-4)),
            cubic_arcsec=float(rng.normal(0.0, 1.5e-3)),
            fringe_arcsec=float(rng.uniform(0.0, 4e-3)),
            fringe_period_arcsec=float(rng.uniform(1.2, 6.0)),
        ),
        two_heads_arcsec=float(rng.normal(0.0, 2e-3)),
        on_polygon=on_polygon,
        face=np.where(on_polygon, schedule.face - 1, 0),
        beside_arcsec=np.where(on_polygon, np.rad2deg(beside_rad) * 3600.0, 0.0),
    )


def mounting(schedule: Schedule) -> Integers:
    """Number of the polygon's mounting at each reading: a new one wherever its offset changes, shape [n]."""
    changed = np.diff(schedule.polygon_offset, prepend=schedule.polygon_offset[:1]) != 0
    return np.cumsum(changed).astype(np.int64)
