"""Causes in the joint itself: heat, friction, load, time and scatter."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.metrological.chain import Bench, Part
from trueangle_training.plant.metrological.grating_lines import Ruling, screw_error
from trueangle_training.plant.metrological.joint_known import HIGHEST_ORDER, SPAN_K, any_phase, expansion
from trueangle_training.plant.metrological.stops import friction_at_readings

Floats = NDArray[np.float64]


def thermal_eccentricity(bench: Bench, rng: np.random.Generator) -> Defect:
    """Hub and disc expand differently and on one side are held: the centre walks."""
    toward = np.exp(1j * any_phase(rng))
    grown = expansion(bench.warming_k, steepening_per_k=float(rng.normal(0.0, 5e-4)))
    return Defect(
        name="thermal_eccentricity",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(centre_arcsec=size * toward * grown),
        cells=(CellTruth(order="1", temperature="linear"),),
        parameters={},
    )


def thermal_tilt(bench: Bench, rng: np.random.Generator) -> Defect:
    """A hub held at two points goes out of round."""
    along = np.exp(1j * any_phase(rng))
    grown = expansion(bench.warming_k, steepening_per_k=float(rng.normal(0.0, 5e-4)))
    return Defect(
        name="thermal_tilt",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(strain_arcsec=size * along * grown),
        cells=(CellTruth(order="2", temperature="linear"),),
        parameters={},
    )


def thermal_graduation(bench: Bench, rng: np.random.Generator) -> Defect:
    """Spots of glue strain the disc between them: an order from 3, or two."""
    orders = rng.choice(np.arange(3, HIGHEST_ORDER + 1), size=int(rng.integers(1, 3)), replace=False)
    stick = float(rng.uniform(0.0, 0.2))
    lines = np.zeros(bench.encoder.lines_per_rev)
    for order in orders.tolist():
        lines += screw_error(lines.size, order=order, phase_rad=any_phase(rng), stick=stick)
    grown = expansion(bench.warming_k, steepening_per_k=float(rng.normal(0.0, 5e-4)))
    return Defect(
        name="thermal_graduation",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(rulings=(Ruling(lines_arcsec=size * lines, course=grown),)),
        cells=tuple(CellTruth(order=str(k), temperature="linear") for k in orders.tolist()),
        parameters={f"order_{i + 1}": float(k) for i, k in enumerate(orders.tolist())},
    )


def softening(warming_k: Floats, *, width_k: float) -> Floats:
    """Path under a force that grows in proportion to a small warming and levels off: near (t / 15 K)^2, shape [n].

    The integral of tanh(t / w): w ln cosh(t / w), doubled and over 15 K twice.
    """
    return 2.0 * width_k**2 * np.log(np.cosh(warming_k / width_k)) / SPAN_K**2


def thermal_nonlinearity(bench: Bench, rng: np.random.Generator) -> Defect:
    """Glue that pulls the less, the warmer it is, and the more, the colder: a bend at order 1 or 2."""
    order, toward = int(rng.integers(1, 3)), np.exp(1j * any_phase(rng))
    bend = softening(bench.warming_k, width_k=float(rng.uniform(25.0, 70.0)))
    bend = bend + float(rng.normal(0.0, 0.08)) * (bench.warming_k / SPAN_K) ** 3

    def contribute(size: float) -> Part:
        moved = size * toward * bend
        return Part(centre_arcsec=moved) if order == 1 else Part(strain_arcsec=moved)

    return Defect(
        name="thermal_nonlinearity",
        in_library=True,
        kind="mean",
        contribute=contribute,
        cells=(CellTruth(order=str(order), temperature="quadratic"),),
        parameters={"order": float(order)},
    )


def thermal_lag(bench: Bench, rng: np.random.Generator) -> Defect:
    """The disc is heated through its hub only: its expansion comes later than the probe says."""
    constant_s = float(np.exp(rng.uniform(np.log(500.0), np.log(5000.0))))
    behind = bench.soak.behind_c(constant_s) - bench.soak.temperature_c
    toward, along = np.exp(1j * any_phase(rng)), float(rng.normal(0.0, 0.15))
    return Defect(
        name="thermal_lag",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(centre_arcsec=size * toward * behind, turned_arcsec=size * along * behind),
        cells=(CellTruth(order="1", temperature="lagged"), CellTruth(order="0", temperature="lagged")),
        parameters={"time_constant_s": constant_s},
    )


def self_heating(bench: Bench, rng: np.random.Generator) -> Defect:
    """Rubbing seals warm a ring that the probe does not touch."""
    constant_s = float(np.exp(rng.uniform(np.log(400.0), np.log(3000.0))))
    heat = bench.soak.friction_heat(constant_s, slow_share=float(rng.uniform(0.0, 0.2)))
    heat = heat / max(float(heat.max()), 1e-9)
    toward, once = np.exp(1j * any_phase(rng)), float(rng.uniform(0.2, 0.6))
    return Defect(
        name="self_heating",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(turned_arcsec=size * heat, centre_arcsec=size * once * toward * heat),
        cells=(
            CellTruth(order="0", time="within_run"),
            CellTruth(order="0", speed="linear"),
            CellTruth(order="1", time="within_run"),
            *(CellTruth(order=order, time="within_run", speed="linear") for order in ("0", "1")),
        ),
        parameters={"time_constant_s": constant_s},
    )


def temperature_sensor_error(bench: Bench, rng: np.random.Generator) -> Defect:
    """The probe's bias and gain: taken up wherever the thermal response that is modelled is linear."""
    return Defect(
        name="temperature_sensor_error",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(),
        cells=(CellTruth(order="1", temperature="linear"),),
        parameters={"bias_c": float(rng.normal(0.0, 1.0)), "gain": 1.0 + float(rng.normal(0.0, 0.04))},
    )


def hysteresis(bench: Bench, rng: np.random.Generator) -> Defect:
    """A coupling with three elastic stops, slipping one after the other; stiffer on one side."""
    thresholds = np.exp(rng.uniform(np.log(0.05), np.log(0.9), size=3))
    weights = rng.dirichlet(np.ones(3))
    state = friction_at_readings(bench.schedule, thresholds_deg=thresholds, weights=weights)
    order, uneven = int(rng.integers(1, 3)), float(rng.uniform(0.1, 0.5))
    stiffer = 1.0 + uneven * np.sin(order * np.deg2rad(bench.schedule.angle_deg) + any_phase(rng))
    return Defect(
        name="hysteresis",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(turned_arcsec=-size * state * stiffer),
        cells=(CellTruth(order="0", direction="odd"), CellTruth(order=str(order), direction="odd")),
        parameters={"slip_deg": float(2.0 * thresholds.max())},
    )


def windup(bench: Bench, rng: np.random.Generator) -> Defect:
    """A hose that is dragged along in its clamps: stops that yield only after a long way."""
    thresholds = np.exp(rng.uniform(np.log(8.0), np.log(45.0), size=3))
    weights = rng.dirichlet(np.full(3, 2.0))
    state = friction_at_readings(bench.schedule, thresholds_deg=thresholds, weights=weights)
    return Defect(
        name="windup",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(turned_arcsec=-size * state),
        cells=(CellTruth(order="0", direction="odd", time="within_run"), CellTruth(order="0", direction="odd")),
        parameters={"slip_deg": float(2.0 * weights @ thresholds)},
    )


def bearing_wobble(bench: Bench, rng: np.random.Generator) -> Defect:
    """The axis goes round an ellipse with the cage, or with its balls passing: not closed over a turn."""
    ratio = float(rng.uniform(0.37, 0.46)) * float(rng.choice([1.0, 7.0, 8.0, 9.0, 11.0, 13.0]))
    if abs(ratio - round(ratio)) < 0.12:
        ratio = round(ratio) + float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.12, 0.4))
    shaft = np.deg2rad(bench.schedule.angle_deg)
    turned = ratio * shaft + any_phase(rng)
    flat = float(rng.uniform(0.0, 0.3)) * np.exp(1j * any_phase(rng))
    axis = np.exp(1j * turned) + flat * np.exp(-1j * turned)
    # The axis moves in the room; the disc sees that turned back by the shaft's angle.
    centre = np.asarray(axis * np.exp(1j * shaft), dtype=np.complex128)
    return Defect(
        name="bearing_wobble",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(centre_arcsec=size * centre),
        cells=(CellTruth(order="non-integer"),),
        parameters={"order": ratio},
    )


def load_deflection(bench: Bench, rng: np.random.Generator) -> Defect:
    """A torque winds the shaft up, nearly in proportion, and an arm's weight goes round with it."""
    load = bench.schedule.load_nm / float(bench.schedule.load_nm.max())
    arm, power = float(rng.uniform(0.0, 0.7)), float(rng.uniform(0.92, 1.0))
    carried = 1.0 + arm * np.sin(np.deg2rad(bench.schedule.angle_deg) + any_phase(rng))
    twist = load**power * carried
    return Defect(
        name="load_deflection",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(turned_arcsec=-size * twist),
        cells=(CellTruth(order="0", load="linear"), CellTruth(order="1", load="linear")),
        parameters={"arm": arm},
    )


def index_drift(bench: Bench, rng: np.random.Generator) -> Defect:
    """A clamp that relaxes after each set-up: a stretched exponential (Kohlrausch)."""
    constant_s = float(np.exp(rng.uniform(np.log(60.0), np.log(1200.0))))
    stretch = float(rng.uniform(0.75, 1.0))
    relaxed = -np.expm1(-((bench.schedule.seconds_into_run() / constant_s) ** stretch))
    return Defect(
        name="index_drift",
        in_library=True,
        kind="mean",
        contribute=lambda size: Part(turned_arcsec=size * relaxed),
        cells=(CellTruth(order="0", time="within_run"),),
        parameters={"time_constant_s": constant_s, "stretch": stretch},
    )


def run_to_run_eccentricity(bench: Bench, rng: np.random.Generator) -> Defect:
    """The hub has play and is clamped anywhere within it: places evenly spread over a small disc."""
    runs, which = np.unique(bench.schedule.run, return_inverse=True)
    radii = 1.5 * np.sqrt(rng.random(runs.size))
    seats = np.asarray(radii * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, size=runs.size)), dtype=np.complex128)
    seats = seats[which]
    return Defect(
        name="run_to_run_eccentricity",
        in_library=True,
        kind="random",
        contribute=lambda size: Part(centre_arcsec=size * seats),
        cells=(CellTruth(order="1", time="between_runs"),),
        parameters={},
    )


def noise_growth(bench: Bench, rng: np.random.Generator) -> Defect:
    """Scatter that grows with heat, speed or load: whichever changes in this campaign."""
    schedule = bench.schedule
    steep = float(rng.uniform(0.5, 2.0))
    grown = {
        "temperature": np.expm1(steep * bench.from_cold_to_hot),
        "speed": np.abs(schedule.velocity_deg_s) ** float(rng.uniform(0.8, 1.2)),
        "load": (schedule.load_nm - float(schedule.load_nm.min())) ** float(rng.uniform(0.8, 1.2)),
    }
    changing = [name for name, values in grown.items() if float(np.ptp(values)) > 1e-9]
    name = str(rng.choice(changing))
    growth = grown[name] / float(np.sqrt(np.mean(grown[name] ** 2)))
    cells = {
        "temperature": CellTruth(order="0", temperature="linear", moment="variance"),
        "speed": CellTruth(order="0", speed="linear", moment="variance"),
        "load": CellTruth(order="0", load="linear", moment="variance"),
    }
    return Defect(
        name="noise_growth",
        in_library=True,
        kind="variance",
        contribute=lambda size: Part(scatter_arcsec=abs(size) * growth),
        cells=(cells[name],),
        parameters={},
    )
