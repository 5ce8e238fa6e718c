"""What friction, torque, bearings and rest do to the shaft."""

import numpy as np

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.mechanical.bearing import draw_bearing, rolled_turns, whole
from trueangle_training.plant.mechanical.chain import Floats, Share, Stand, phasor
from trueangle_training.plant.mechanical.friction import BoucWen, LuGre, bouc_wen_torque, lugre_torque
from trueangle_training.plant.mechanical.torsion import Coupling, twist


def draw_lugre(rng: np.random.Generator) -> LuGre:
    """A greased bearing with its seal."""
    return LuGre(
        bristle_deg=float(rng.uniform(0.15, 0.7)),
        breakaway=float(rng.uniform(1.0, 1.06)),
        stribeck_deg_s=float(rng.uniform(0.3, 1.5)),
        viscous_s_deg=float(rng.uniform(0.0, 0.001)),
        braking_deg_s2=float(rng.uniform(30.0, 90.0)),
    )


def hysteresis(stand: Stand, rng: np.random.Generator) -> Defect:
    """Friction at the encoder's end twists the coupling, more where the seal is tight."""
    bearing, order = draw_lugre(rng), int(rng.integers(1, 3))
    seal = float(rng.uniform(0.1, 0.5))
    torque = lugre_torque(stand.conditions.schedule, bearing)
    tight = 1.0 + seal * (phasor(rng) * np.exp(1j * order * stand.angle_rad)).real
    return Defect(
        name="hysteresis",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(twist_arcsec=size * torque * tight),
        cells=(CellTruth(order="0", direction="odd"), CellTruth(order=str(order), direction="odd")),
        parameters={"bristle_deg": bearing.bristle_deg},
    )


def windup(stand: Stand, rng: np.random.Generator) -> Defect:
    """A cable in the hollow shaft winds up over tens of degrees after each reversal."""
    cable = BoucWen(
        length_deg=float(np.exp(rng.uniform(np.log(10.0), np.log(60.0)))),
        exponent=float(rng.uniform(0.9, 1.4)),
        loading=float(rng.uniform(0.5, 0.7)),
    )
    schedule = stand.conditions.schedule
    torque = bouc_wen_torque(schedule.path_angle_deg, cable)[schedule.reading_at]
    return Defect(
        name="windup",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(twist_arcsec=size * torque),
        cells=(CellTruth(order="0", direction="odd", time="within_run"), CellTruth(order="0", direction="odd")),
        parameters={"length_deg": cable.length_deg},
    )


def bearing_wobble(stand: Stand, rng: np.random.Generator) -> Defect:
    """One ball is larger, or the ring is soft between the balls: the axis goes round with cage or balls."""
    while True:
        bearing = draw_bearing(rng)
        ratio = bearing.cage_ratio if rng.random() < 0.5 else bearing.passing_ratio
        if not whole(ratio):
            break
    rolled = (
        2.0 * np.pi * rolled_turns(stand.conditions.schedule, ratio=ratio, slip=float(rng.uniform(-5e-6, 5e-6)))
    )
    path = phasor(rng) * np.exp(1j * rolled) + float(rng.uniform(0.0, 0.15)) * phasor(rng) * np.exp(2j * rolled)
    return Defect(
        name="bearing_wobble",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(axis_arcsec=size * path),
        cells=(CellTruth(order="non-integer"),),
        parameters={"order": ratio},
    )


def load_deflection(stand: Stand, rng: np.random.Generator) -> Defect:
    """The load's torque twists shaft and coupling, and its weight, on an arm, bends the shaft aside."""
    load = stand.conditions.schedule.load_nm / float(stand.conditions.schedule.load_nm.max())
    arm, aside = float(rng.uniform(0.0, 0.8)), float(rng.uniform(0.0, 0.4)) * phasor(rng)
    torque = load * (1.0 + arm * (phasor(rng) * np.exp(1j * stand.angle_rad)).real)
    coupling = Coupling(softness=1.0, hardening=float(rng.uniform(0.0, 0.02)), shaft_softness=0.2)
    turned = twist(torque, coupling)
    return Defect(
        name="load_deflection",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(twist_arcsec=size * turned, axis_arcsec=size * load * aside),
        cells=(CellTruth(order="0", load="linear"), CellTruth(order="1", load="linear")),
        parameters={"arm": arm},
    )


def index_drift(stand: Stand, rng: np.random.Generator) -> Defect:
    """The head's clamp creeps after each set-up: three Kelvin and Voigt elements in a row."""
    first_s = float(np.exp(rng.uniform(np.log(50.0), np.log(900.0))))
    weights = rng.dirichlet([6.0, 2.0, 1.0])
    since = stand.conditions.schedule.seconds_into_run()
    creep: Floats = -sum(
        (weight * np.expm1(-since / (first_s * 2.5**i)) for i, weight in enumerate(weights.tolist())),
        np.zeros_like(since),
    )
    return Defect(
        name="index_drift",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(index_arcsec=size * creep),
        cells=(CellTruth(order="0", time="within_run"),),
        parameters={"time_constant_s": first_s},
    )


def read_latency(stand: Stand, rng: np.random.Generator) -> Defect:
    """The encoder's filter and bus are slow, or the reference's trigger is."""
    fastest = max(float(np.abs(stand.conditions.schedule.velocity_deg_s).max()), 1.0)
    sense = float(rng.choice([1.0, 1.0, -1.0]))
    return Defect(
        name="read_latency",
        in_library=True,
        kind="mean",
        contribute=lambda size: Share(late_s=sense * size / 3600.0 / fastest),
        cells=(CellTruth(order="0", speed="linear"), CellTruth(order="0", direction="odd", speed="linear")),
        parameters={},
    )


def noise_growth(stand: Stand, rng: np.random.Generator) -> Defect:
    """Thinner grease, faster motion or more load shake the shaft more: whichever changes in this campaign."""
    schedule = stand.conditions.schedule
    fast = np.abs(schedule.velocity_deg_s)
    choices = {
        "temperature": np.exp(0.9 * stand.conditions.relative_temperature) - np.exp(-0.9),
        "speed": fast,
        "load": schedule.load_nm - schedule.load_nm.min(),
    }
    axis = str(rng.choice([name for name, values in choices.items() if float(np.ptp(values)) > 1e-9]))
    growth = choices[axis] / float(np.sqrt(np.mean(choices[axis] ** 2)))
    cell = {
        "temperature": CellTruth(order="0", temperature="linear", moment="variance"),
        "speed": CellTruth(order="0", speed="linear", moment="variance"),
        "load": CellTruth(order="0", load="linear", moment="variance"),
    }[axis]
    return Defect(
        name="noise_growth",
        in_library=True,
        kind="variance",
        contribute=lambda size: Share(scatter_arcsec=abs(size) * growth),
        cells=(cell,),
        parameters={},
    )
