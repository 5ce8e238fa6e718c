"""Temperatures in the wrong unit: some of a campaign in degrees Fahrenheit, or all of it.

Kelvin gives itself away by its size; Fahrenheit does not, 59 degF of an encoder at 15 degC is a possible
temperature too. What gives it away is the error: it fits the other temperatures at the converted value and not at
the stated one. Where all temperatures are in another unit nothing contradicts them, except the joint's own base
temperature.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import Fault
from trueangle.contract.units import wrap_deg
from trueangle_training.evaluation.held_out import temperature_groups
from trueangle_training.methods import TrainingReadings, distinct_angle_count
from trueangle_training.methods.coefficients import centred
from trueangle_training.methods.separable import harmonics
from trueangle_training.temperature_places import lines_text

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

HIGHEST_ORDER, HIGHEST_THERMAL_ORDER = 11, 3
HIGHEST_DEGREE = 2
FEWEST_OTHERS = 2
"""Temperatures to hold the others against: with one there is no change to go by."""
ROOM_OVER_SPAN = 0.25
"""How far beyond the other temperatures a converted one may lie, in parts of their span: farther, the polynomial
says nothing."""
FIT_OVER_NOISE = 2.0
"""Of a fit at the converted temperature, over what the surface leaves of the others: prediction adds some."""
KINK_OVER_NOISE = 1.4
"""What one surface through all leaves as stated, over what it leaves as converted, where the hotter part of a
campaign would continue the colder one once converted: as stated, the slope breaks where the unit changes."""
SURELY_OFF = 4.0
"""Misfit as stated over misfit as converted."""
NEAR_BASE_C = 5.0
"""Campaigns go in steps of 5 to 10 degC: one made around the base temperature has a run this near."""
SAME_TEMPERATURE_C = 1.0


def celsius(fahrenheit: Floats) -> Floats:
    """degC of degF."""
    return (fahrenheit - 32.0) / 1.8


def fahrenheit(temperature_c: Floats) -> Floats:
    """degF of degC."""
    return 1.8 * temperature_c + 32.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Suspicion:
    """Temperatures that fit the others once converted."""

    chosen: NDArray[np.bool_]
    """[readings]"""
    stated_arcsec: float
    """RMS from the surface of the others, as stated."""
    converted_arcsec: float
    converted_c: Floats
    """[chosen readings]"""
    to_celsius: bool
    """False: the others are in Fahrenheit and these are not."""


def mixed_unit_faults(readings: TrainingReadings, row: Integers, *, source: str) -> list[Fault]:
    """Temperatures whose errors fit the others only as degrees Fahrenheit; `row` [readings]: file lines."""
    found = max(_suspicions(readings), key=lambda each: each.stated_arcsec / each.converted_arcsec, default=None)
    if found is None:
        return []
    rows = np.sort(row[found.chosen])
    stated_c = readings.temperature_c[found.chosen]
    unit = "these" if found.to_celsius else "all others"
    return [
        Fault(
            where=f"{source} {lines_text(rows)}, column temperature_c",
            expected="errors that change with temperature as at all other temperatures",
            found=f"at {_span(stated_c)} errors {found.stated_arcsec:.3g} arcsec RMS off; they fit to "
            f"{found.converted_arcsec:.3g} arcsec at {_span(found.converted_c)}",
            advice=f"are {unit} in degrees Fahrenheit? Mend the column, or leave lines out with --exclude-rows "
            f"{rows[0]}-{rows[-1]}",
        )
    ]


def base_temperature_warnings(
    run_mean_c: Floats, base_temperature_c: float | None, *, source: str
) -> tuple[str, ...]:
    """One sentence where no run is near the joint's base temperature; none where no joint is described."""
    if base_temperature_c is None or (np.abs(run_mean_c - base_temperature_c) <= NEAR_BASE_C).any():
        return ()
    levels_c = np.unique(np.round(run_mean_c))
    listed = ", ".join(f"{each:g}" for each in levels_c)
    text = (
        f"{source}, column temperature_c: no run within {NEAR_BASE_C:g} degC of the joint's base temperature "
        f"{base_temperature_c:g} degC (runs at about {listed} degC)"
    )
    converted_c = celsius(run_mean_c)
    if (np.abs(converted_c - base_temperature_c) <= SAME_TEMPERATURE_C).any():
        text += (
            f". Are they in degrees Fahrenheit? As such they would be {converted_c.min():.0f} to "
            f"{converted_c.max():.0f} degC"
        )
    return (text,)


def _span(temperature_c: Floats) -> str:
    lowest, highest = float(temperature_c.min()), float(temperature_c.max())
    if highest - lowest < SAME_TEMPERATURE_C:
        return f"{float(temperature_c.mean()):.1f} degC"
    return f"{lowest:.1f} to {highest:.1f} degC"


def _suspicions(readings: TrainingReadings) -> Iterator[_Suspicion]:
    """Of each temperature by itself, and of all hotter, or all colder, than one."""
    surface = _surface_of(readings)
    group = temperature_groups(readings)
    count = int(group.max()) + 1
    sums = surface.sums(readings.temperature_c, group, count)
    for to_celsius in (True, False):
        convert = celsius if to_celsius else fahrenheit
        tails = [np.arange(first, count) if to_celsius else np.arange(count - first) for first in range(1, count)]
        for members in (*(np.array([each]) for each in range(count)), *tails):
            others = np.setdiff1d(np.arange(count), members)
            if others.size < FEWEST_OTHERS:
                continue
            chosen = np.isin(group, members)
            found = _suspicion(readings, surface, sums, chosen, others, convert)
            if found is not None:
                yield _Suspicion(
                    chosen=chosen,
                    stated_arcsec=found[0],
                    converted_arcsec=found[1],
                    converted_c=convert(readings.temperature_c[chosen]),
                    to_celsius=to_celsius,
                )


def _suspicion(
    readings: TrainingReadings,
    surface: "_Surface",
    sums: "_Sums",
    chosen: NDArray[np.bool_],
    others: Integers,
    convert: Callable[[Floats], Floats],
) -> tuple[float, float] | None:
    """RMS as stated and as converted; None: nothing to suspect."""
    others_c, stated_c = readings.temperature_c[~chosen], readings.temperature_c[chosen]
    converted_c = convert(stated_c)
    room_c = ROOM_OVER_SPAN * float(np.ptp(others_c))
    if converted_c.min() < others_c.min() - room_c or converted_c.max() > others_c.max() + room_c:
        return _kink(readings, surface, sums, chosen, converted_c)
    degree = min(HIGHEST_DEGREE, others.size - 1)
    solution, noise = sums.solve(others, surface.columns(degree))
    stated, converted = (
        surface.misfit_arcsec(chosen, temperature_c, solution) for temperature_c in (stated_c, converted_c)
    )
    fits = converted <= FIT_OVER_NOISE * noise and stated >= SURELY_OFF * max(converted, np.finfo(float).tiny)
    return (stated, converted) if fits else None


def _kink(
    readings: TrainingReadings, surface: "_Surface", sums: "_Sums", chosen: NDArray[np.bool_], converted_c: Floats
) -> tuple[float, float] | None:
    """The same for a part of the campaign that converted temperatures would continue instead of filling a gap."""
    others_c = readings.temperature_c[~chosen]
    continues_up = converted_c.min() > others_c.max() and converted_c.max() < readings.temperature_c[chosen].max()
    continues_down = converted_c.max() < others_c.min()
    if not continues_up and not (continues_down and converted_c.max() > readings.temperature_c[chosen].max()):
        return None
    temperature_c = readings.temperature_c.copy()
    temperature_c[chosen] = converted_c
    everything = np.arange(sums.square.size)
    columns = surface.columns(min(HIGHEST_DEGREE, everything.size - 1))
    stated = sums.solve(everything, columns)[1]
    # The columns are linear in the powers of temperature: another temperature asks for other sums.
    whole = np.zeros(len(readings), dtype=np.int64)
    converted = surface.sums(temperature_c, whole, 1).solve(np.array([0]), columns)[1]
    return (stated, converted) if stated >= KINK_OVER_NOISE * max(converted, np.finfo(float).tiny) else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sums:
    """Normal equations of each temperature: a hypothesis adds up those that it trusts."""

    gram: Floats
    """[temperatures, columns, columns]"""
    right: Floats
    """[temperatures, columns]"""
    square: Floats
    """[temperatures]"""
    freedoms: Floats
    """[temperatures]: readings less zeros."""

    def solve(self, trusted: Integers, columns: int) -> tuple[Floats, float]:
        """Coefficients [columns], and the RMS that they leave of the trusted readings."""
        gram = self.gram[trusted].sum(axis=0)[:columns, :columns]
        right = self.right[trusted].sum(axis=0)[:columns]
        solution, _, rank, _ = np.linalg.lstsq(gram, right, rcond=1e-10)
        left = float(self.square[trusted].sum() - right @ solution)
        freedoms = max(float(self.freedoms[trusted].sum()) - int(rank), 1.0)
        return solution, float(np.sqrt(max(left, 0.0) / freedoms))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Surface:
    """Steady harmonics, and the low ones times powers of temperature, less the mean of each zero group."""

    by_angle: Floats
    """[readings, 2 orders]"""
    error_arcsec: Floats
    """[readings], less the mean of each zero group."""
    zero: Integers
    centre_c: float
    scale_c: float

    def columns(self, degree: int) -> int:
        """How many columns the powers up to `degree` take."""
        return self.by_angle.shape[1] + degree * self._thermal

    @property
    def _thermal(self) -> int:
        return min(2 * HIGHEST_THERMAL_ORDER, self.by_angle.shape[1])

    def _design(self, by_angle: Floats, temperature_c: Floats, zero: Integers) -> Floats:
        t = (temperature_c - self.centre_c) / self.scale_c
        powers = [by_angle[:, : self._thermal] * t[:, None] ** power for power in range(1, HIGHEST_DEGREE + 1)]
        return centred(np.concatenate([by_angle, *powers], axis=1), zero)

    def sums(self, temperature_c: Floats, group: Integers, count: int) -> _Sums:
        """Of every temperature, all as stated."""
        design = self._design(self.by_angle, temperature_c, self.zero)
        parts = [(design[group == each], self.error_arcsec[group == each]) for each in range(count)]
        return _Sums(
            gram=np.stack([part.T @ part for part, _ in parts]),
            right=np.stack([part.T @ error for part, error in parts]),
            square=np.array([float(error @ error) for _, error in parts]),
            freedoms=np.array(
                [
                    np.count_nonzero(group == each) - np.unique(self.zero[group == each]).size
                    for each in range(count)
                ],
                dtype=np.float64,
            ),
        )

    def misfit_arcsec(self, chosen: NDArray[np.bool_], temperature_c: Floats, solution: Floats) -> float:
        """RMS of the chosen readings about the surface, were they at `temperature_c` [chosen]."""
        zero = np.unique(self.zero[chosen], return_inverse=True)[1].reshape(-1)
        design = self._design(self.by_angle[chosen], temperature_c, zero)[:, : solution.size]
        left = self.error_arcsec[chosen] - design @ solution
        freedoms = max(left.size - int(zero.max()) - 1, 1)
        return float(np.sqrt(float(left @ left) / freedoms))


def _surface_of(readings: TrainingReadings) -> _Surface:
    order = min(HIGHEST_ORDER, (distinct_angle_count(readings.angle_deg) - 1) // 2)
    zero = readings.offset_group
    return _Surface(
        by_angle=harmonics(wrap_deg(readings.angle_deg), tuple(range(1, order + 1))),
        error_arcsec=centred(readings.error_arcsec[:, None], zero)[:, 0],
        zero=zero,
        centre_c=float(readings.temperature_c.mean()),
        scale_c=float(np.ptp(readings.temperature_c)) or 1.0,
    )
