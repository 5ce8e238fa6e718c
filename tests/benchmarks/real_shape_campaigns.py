"""Campaigns in the shape of real encoders: the curve of a calibration table, our noise, and one thing planted.

The stops are set points of the joint's own 14-bit encoder. Noise of a fiftieth of the curve's RMS: a 1/f part
through the whole campaign and a white part with heavy tails. Shapes are written for here, none is the library's.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign, campaign_to_csv, read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import Joint, joint_from_document

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

COUNTS = 16_384
COUNT_ARCSEC = 1_296_000 / COUNTS
STOPS = 47
RUNS = 8
READING_S, BETWEEN_RUNS_S = 4.0, 1200.0
NOISE_SHARE = 1 / 50
"""Of the curve's RMS."""
MAKER_ORDER = 15
"""A maker lists what stands clear of the half count to which the firmware averages: in tables 05 and 06 no order
above 12 exceeds a quarter of it."""
EVERY_ORDER = (STOPS - 1) // 2
"""With all of them no curve of the angle, whatever its shape, is left."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """One calibration of one unit."""

    angle_deg: Floats
    error_arcsec: Floats

    def curve_arcsec(self, angle_deg: Floats) -> Floats:
        """Linear between the rows, closed over the turn."""
        return np.interp(np.mod(angle_deg, 360.0), self.angle_deg, self.error_arcsec, period=360.0)

    def harmonics(self) -> Floats:
        """[orders 1 to MAKER_ORDER, cos and sin] in arcsec, by least squares."""
        waves = _waves(self.angle_deg)
        found = np.linalg.lstsq(waves, self.error_arcsec, rcond=None)[0]
        return np.asarray(found[1:], dtype=np.float64).reshape(-1, 2)

    def smooth_arcsec(self, angle_deg: Floats) -> Floats:
        """The orders that a maker models and nothing else."""
        return _waves(angle_deg)[:, 1:] @ self.harmonics().ravel()


def _waves(angle_deg: Floats) -> Floats:
    theta = np.radians(angle_deg)
    orders = range(1, MAKER_ORDER + 1)
    return np.column_stack([np.ones_like(theta), *(f(k * theta) for k in orders for f in (np.cos, np.sin))])


def read_tables(folder: Path) -> dict[str, Table]:
    """Name to table, of every file in the folder."""
    tables: dict[str, Table] = {}
    for path in sorted(folder.glob("table*.csv")):
        read = read_campaign(path.read_bytes(), source=path.name)
        tables[path.stem] = Table(angle_deg=read.angle_deg, error_arcsec=read.error_arcsec)
    return tables


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """Where and when the readings are taken; arrays of shape [readings]."""

    angle_deg: Floats
    run: Integers
    time_s: Floats
    direction: Integers
    travel_deg: Floats
    """Since the last reversal, the way back to the run's begin being one."""


def layout(*, both_ways: bool) -> Layout:
    """Each run two turns one way, or one turn there and back under the same zero."""
    turn = np.arange(STOPS)
    stops = np.concatenate([turn, turn[::-1]]) if both_ways else np.arange(2 * STOPS)
    direction = np.repeat([1, -1], STOPS) if both_ways else np.ones(2 * STOPS, dtype=np.int64)
    travel = np.concatenate([turn, turn]) if both_ways else stops
    angle_deg = np.rint(stops * COUNTS / STOPS) * 360.0 / COUNTS
    run = np.repeat(np.arange(RUNS), stops.size)
    reading = np.arange(run.size)
    return Layout(
        angle_deg=np.tile(angle_deg, RUNS),
        run=run,
        time_s=reading * READING_S + run * BETWEEN_RUNS_S,
        direction=np.tile(direction, RUNS).astype(np.int64),
        travel_deg=(np.tile(travel, RUNS) + 0.5) * 360.0 / STOPS,
    )


def noise(where: Layout, sigma_arcsec: float, rng: np.random.Generator) -> Floats:
    """[readings] with standard deviation sigma_arcsec about the mean of each run."""
    count = where.run.size
    frequency = np.fft.rfftfreq(count)
    frequency[0] = frequency[1]
    pink = np.fft.irfft(np.fft.rfft(rng.normal(size=count)) / np.sqrt(frequency), count)
    degrees = rng.uniform(4.0, 8.0)
    white = rng.standard_t(degrees, size=count)
    share = rng.uniform(0.1, 0.4)
    raw = np.sqrt(share) * _unit(pink, where) + np.sqrt(1.0 - share) * _unit(white, where)
    return sigma_arcsec * _unit(raw, where)


def _unit(values: Floats, where: Layout) -> Floats:
    left = values - (np.bincount(where.run, weights=values) / np.bincount(where.run))[where.run]
    return left / float(np.std(left))


Shape = Callable[[Layout, np.random.Generator], Floats]


def _bump(where: Layout, rng: np.random.Generator) -> Floats:
    """A raised cosine, 6 to 14 deg wide at half its height."""
    width_deg = rng.uniform(6.0, 14.0)
    away_deg = np.mod(where.angle_deg - rng.uniform(0.0, 360.0) + 180.0, 360.0) - 180.0
    return np.where(np.abs(away_deg) < width_deg, 0.5 + 0.5 * np.cos(np.pi * away_deg / width_deg), 0.0)


def _order(where: Layout, rng: np.random.Generator) -> Floats:
    order = int(rng.integers(MAKER_ORDER + 2, EVERY_ORDER))
    return np.cos(order * np.radians(where.angle_deg) - rng.uniform(0.0, 2 * np.pi))


def _step(where: Layout, rng: np.random.Generator) -> Floats:
    """From one reading of one run to the run's end; one count high."""
    run = int(rng.integers(RUNS))
    since = np.arange(where.run.size) - int(np.flatnonzero(where.run == run)[0])
    return np.where((where.run == run) & (since >= rng.integers(6, 2 * STOPS - 6)), COUNT_ARCSEC, 0.0)


def _wobble(where: Layout, rng: np.random.Generator) -> Floats:
    """The cage of a ball bearing with a little overtone."""
    phase = rng.uniform(0.36, 0.45) * np.radians(where.angle_deg) - rng.uniform(0.0, 2 * np.pi)
    return np.cos(phase) + 0.15 * np.cos(2 * phase - rng.uniform(0.0, 2 * np.pi))


def _creep(where: Layout, rng: np.random.Generator) -> Floats:
    """Logarithmic, as of a clamped or glued joint."""
    began_s = where.time_s[np.searchsorted(where.run, where.run)]
    return np.log1p((where.time_s - began_s) / rng.uniform(20.0, 80.0))


def _seating(where: Layout, rng: np.random.Generator) -> Floats:
    vector = rng.normal(size=(RUNS, 2))[where.run]
    theta = np.radians(where.angle_deg)
    return vector[:, 0] * np.cos(theta) + vector[:, 1] * np.sin(theta)


def _backlash(where: Layout, rng: np.random.Generator) -> Floats:
    theta = np.radians(where.angle_deg)
    return where.direction * (1.0 + 0.3 * np.cos(theta - rng.uniform(0.0, 2 * np.pi)))


def _twist(where: Layout, rng: np.random.Generator) -> Floats:
    """From one side to the other within some tens of degrees after a reversal."""
    return where.direction * (2.0 * np.tanh(where.travel_deg / rng.uniform(20.0, 50.0)) - 1.0)


EFFECTS: Mapping[str, Shape] = {
    "localized_defect": _bump,
    "graduation_error": _order,
    "count_loss": _step,
    "bearing_wobble": _wobble,
    "index_drift": _creep,
    "run_to_run_eccentricity": _seating,
    "hysteresis": _backlash,
    "windup": _twist,
}
CONSTANT = ("localized_defect", "graduation_error")
"""A joint that models every order has these."""
BOTH_WAYS = ("hysteresis", "windup")


def drift_shapes(first: Table, second: Table) -> dict[str, Shape]:
    """The difference of two calibrations of one unit, coming over the campaign or all at once."""

    def growing(where: Layout, rng: np.random.Generator) -> Floats:
        return (where.time_s / where.time_s[-1]) * _difference(where)

    def stepping(where: Layout, rng: np.random.Generator) -> Floats:
        return np.where(where.run >= rng.integers(2, RUNS - 1), _difference(where), 0.0)

    def _difference(where: Layout) -> Floats:
        return second.curve_arcsec(where.angle_deg) - first.curve_arcsec(where.angle_deg)

    return {"drift_growing": growing, "drift_stepping": stepping}


def joint(highest_order: int, nominal: Floats | None = None) -> Joint:
    """Every order up to one; [orders, cos and sin] of the shipped simulator, None: calibrated."""
    effects: dict[str, object] = {"eccentricity": {}, "grating_tilt": {}}
    graduation: dict[str, object] = {"orders": [3, highest_order]}
    if nominal is not None:
        polar = [
            {
                "amplitude_arcsec": float(np.hypot(cos, sin)),
                "phase_deg": float(np.degrees(np.arctan2(sin, cos))),
            }
            for cos, sin in nominal.tolist()
        ]
        effects = {"eccentricity": polar[0], "grating_tilt": polar[1]}
        graduation["harmonics"] = [{"order": 3 + k, **each} for k, each in enumerate(polar[2:])]
    plain = {
        "schema_version": 1,
        "encoder": {"lines_per_rev": 1, "counts_per_rev": COUNTS},
        "reference": {"kind": "encoder"},
        "effects": {**effects, "graduation_error": graduation},
    }
    return joint_from_document(document_from_plain(plain, source="joint.yaml", path=""))


def campaign(where: Layout, error_arcsec: Floats) -> Campaign:
    """Each run zeroed at its first reading; as a file has it, to a thousandth of an arcsecond."""
    began = np.searchsorted(where.run, where.run)
    made = Campaign(
        angle_deg=where.angle_deg,
        error_arcsec=np.round(error_arcsec - error_arcsec[began], 3),
        run=where.run,
        zero_group=where.run,
        row=np.arange(2, where.run.size + 2),
        source="measured.csv",
        sha256="",
        time_s=where.time_s,
        direction=where.direction,
    )
    return read_campaign(campaign_to_csv(made).encode(), source="measured.csv")
