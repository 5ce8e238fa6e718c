"""The grating as a table of its lines, each displaced by itself, and a head that sees a window of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

ARCSEC_PER_RAD = 180.0 * 3600.0 / np.pi
TURN_ARCSEC = 1_296_000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ruling:
    """Displacements of the lines along the track, and how far they have grown at each reading."""

    lines_arcsec: Floats
    """[lines], line k against k times the mean pitch."""
    course: Floats | float = 1.0
    """[n] or one factor for all readings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """A scanning head over the track."""

    lines_per_rev: int
    lines_seen: int
    """Odd; the signal is the mean over these neighbouring lines."""


def disc_displacement_arcsec(disc_rad: Floats, *, centre_arcsec: Complexes, strain_arcsec: Complexes) -> Floats:
    """How far lines at disc angles [n, w] turn about the axis when the disc is shifted and strained.

    A mark at u = exp(i a) goes to u + c + s conj(u): c the centre's shift, s a pure shear, both over the radius
    and here in arcsec, shape [n]. The turn's sine is the cross product of u and its new place over their lengths.
    """
    mark = np.exp(1j * disc_rad)
    moved = mark + (centre_arcsec[:, None] + strain_arcsec[:, None] * np.conj(mark)) / ARCSEC_PER_RAD
    crossed = (np.conj(mark) * moved).imag
    return np.arcsin(crossed / np.abs(moved)) * ARCSEC_PER_RAD


def indicated_arcsec(
    shaft_arcsec: Floats,
    head: Head,
    *,
    centre_arcsec: Complexes,
    strain_arcsec: Complexes,
    rulings: tuple[Ruling, ...] = (),
) -> Floats:
    """Nominal place of the grating under the head, continuous and before interpolation, shape [n].

    A line that is ahead by d is met earlier: the place read is the shaft's angle less the window's mean d. Which
    lines lie in the window follows from the place itself, so it is asked twice.
    """
    pitch_arcsec = TURN_ARCSEC / head.lines_per_rev
    half = head.lines_seen // 2
    place = shaft_arcsec.copy()
    for _ in range(2):
        lines = np.round(place / pitch_arcsec).astype(np.int64)[:, None] + np.arange(-half, half + 1)[None, :]
        ahead = disc_displacement_arcsec(
            np.asarray(lines * (2.0 * np.pi / head.lines_per_rev), dtype=np.float64),
            centre_arcsec=centre_arcsec,
            strain_arcsec=strain_arcsec,
        )
        for ruling in rulings:
            course = np.broadcast_to(np.asarray(ruling.course, dtype=np.float64), shaft_arcsec.shape)
            ahead = ahead + ruling.lines_arcsec[lines % head.lines_per_rev] * course[:, None]
        place = shaft_arcsec - _mean_of_signals(ahead, pitch_arcsec)
    return place


def _mean_of_signals(ahead_arcsec: Floats, pitch_arcsec: float) -> Floats:
    """Displacement of the sum of the lines' signals, shape [n]; far-off lines count less, as their light does."""
    middle = ahead_arcsec.mean(axis=1)
    phasors = np.exp(2j * np.pi * (ahead_arcsec - middle[:, None]) / pitch_arcsec)
    return middle + np.angle(phasors.sum(axis=1)) * pitch_arcsec / (2.0 * np.pi)


def accumulated(pitch_error_arcsec: Floats) -> Floats:
    """Places of lines from the errors of their pitches, closed over the turn and of mean 0, shape [lines]."""
    closed = pitch_error_arcsec - pitch_error_arcsec.mean()
    places = np.cumsum(closed) - 0.5 * closed
    return places - places.mean()


def screw_error(lines_per_rev: int, *, order: int, phase_rad: float, stick: float) -> Floats:
    """A ruling engine's periodic error, `order` times a turn, amplitude near 1, shape [lines].

    Its screw makes pitches too long and too short in turn; `stick` (0: none) flattens the tops of that wave, so
    the accumulated error has some of the third harmonic.
    """
    angle = 2.0 * np.pi * order * np.arange(lines_per_rev) / lines_per_rev + phase_rad
    wave = np.cos(angle)
    wave = wave - stick * wave**3
    return accumulated(wave * 2.0 * np.pi * order / lines_per_rev) / (1.0 - 0.75 * stick)
