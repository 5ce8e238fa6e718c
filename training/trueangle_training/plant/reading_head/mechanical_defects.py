"""What friction, bearings, loads, time and the reference do."""

import numpy as np
from numpy.typing import NDArray

from trueangle_training.plant.defect import CellTruth, Defect
from trueangle_training.plant.history import follow, friction_at_readings
from trueangle_training.plant.reading_head.contribution import Contribution, Setting
from trueangle_training.plant.reading_head.grating_defects import phase
from trueangle_training.plant.reading_head.rolling import cage_angle_deg
from trueangle_training.plant.schedule import FACES

Floats = NDArray[np.float64]


def hysteresis(setting: Setting, rng: np.random.Generator) -> Defect:
    """Seal and bearing friction twist the coupling; more where the seal is tighter."""
    length = float(rng.uniform(0.2, 0.8))
    order, uneven, at = int(rng.integers(1, 3)), float(rng.uniform(0.1, 0.5)), phase(rng)
    state = friction_at_readings(setting.schedule, length_deg=length)
    angle = np.deg2rad(setting.schedule.angle_deg)
    twist = state * (1.0 + uneven * np.cos(order * angle + at))
    return Defect(
        name="hysteresis",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(twist_arcsec=size * twist),
        cells=(CellTruth(order="0", direction="odd"), CellTruth(order=str(order), direction="odd")),
        parameters={"length_deg": length},
    )


def windup(setting: Setting, rng: np.random.Generator) -> Defect:
    """A cable or bellows that is dragged along and goes on winding up long after a reversal."""
    length = float(np.exp(rng.uniform(np.log(10.0), np.log(60.0))))
    state = friction_at_readings(setting.schedule, length_deg=length, exponent=float(rng.uniform(0.85, 1.3)))
    return Defect(
        name="windup",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(twist_arcsec=size * state),
        cells=(CellTruth(order="0", direction="odd", time="within_run"), CellTruth(order="0", direction="odd")),
        parameters={"length_deg": length},
    )


def bearing_wobble(setting: Setting, rng: np.random.Generator) -> Defect:
    """The shaft's axis goes round with the cage, or with a set of balls: not closed over one turn."""
    cage = float(rng.uniform(0.36, 0.46))
    balls = int(rng.choice([0, 7, 8, 9, 10, 11, 12]))
    ratio = cage if balls == 0 else cage * balls
    if abs(ratio - round(ratio)) < 0.12:
        ratio = round(ratio) + 0.12 + 0.2 * float(rng.random())
    rolled = np.deg2rad(cage_angle_deg(setting.schedule, ratio=ratio, slip_per_turn=float(rng.normal(0, 2e-5))))
    once = np.exp(1j * (rolled + phase(rng)))
    oval = float(rng.uniform(0.0, 0.2)) * np.exp(1j * (2.0 * rolled + phase(rng)))
    path = np.asarray(once + oval, dtype=np.complex128)
    return Defect(
        name="bearing_wobble",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(wobble_mm=setting.mm(size) * path),
        cells=(CellTruth(order="non-integer"),),
        parameters={"order": ratio},
    )


def load_deflection(setting: Setting, rng: np.random.Generator) -> Defect:
    """Shaft and coupling give under a torque, part of which comes from a mass on an arm."""
    load = setting.schedule.load_nm / float(setting.schedule.load_nm.max())
    angle = np.deg2rad(setting.schedule.angle_deg)
    arm, at, harder = float(rng.uniform(0.0, 0.8)), phase(rng), float(rng.uniform(0.0, 0.06))
    torque = load * (1.0 + arm * np.cos(angle + at))
    twist = torque / (1.0 + harder * np.abs(torque))
    return Defect(
        name="load_deflection",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(twist_arcsec=size * twist),
        cells=(CellTruth(order="0", load="linear"), CellTruth(order="1", load="linear")),
        parameters={"arm": arm},
    )


def index_drift(setting: Setting, rng: np.random.Generator) -> Defect:
    """After each set-up the clamped head creeps: a spring-damper chain that comes to rest, stepped in time."""
    constant = float(np.exp(rng.uniform(np.log(60.0), np.log(1500.0))))
    step_s = 2.0
    since = setting.schedule.seconds_into_run()
    rest = np.ones(int(since.max() / step_s) + 2)
    rest[0] = 0.0
    fast = follow(rest, time_constant_s=constant, start=0.0, step_s=step_s)
    slow = follow(rest, time_constant_s=4.0 * constant, start=0.0, step_s=step_s)
    share = float(rng.uniform(0.7, 1.0))
    creep = np.interp(since, step_s * np.arange(rest.size), share * fast + (1.0 - share) * slow)
    return Defect(
        name="index_drift",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(head_arcsec=size * creep),
        cells=(CellTruth(order="0", time="within_run"),),
        parameters={"time_constant_s": constant},
    )


def read_latency(setting: Setting, rng: np.random.Generator) -> Defect:
    """The encoder is read late."""
    fastest = max(float(np.abs(setting.schedule.velocity_deg_s).max()), 1.0)
    sense = float(rng.choice([1.0, 1.0, -1.0]))
    return Defect(
        name="read_latency",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(latency_s=sense * size / 3600.0 / fastest),
        cells=(CellTruth(order="0", speed="linear"), CellTruth(order="0", direction="odd", speed="linear")),
        parameters={},
    )


def reference_artefact(setting: Setting, rng: np.random.Generator) -> Defect:
    """Faces that are not where their certificate says."""
    faces = rng.normal(size=FACES + 1)
    faces[0] = 0.0
    faces[1:] -= faces[1:].mean()
    wrong = -faces[setting.schedule.face]
    return Defect(
        name="reference_artefact",
        in_library=True,
        kind="mean",
        contribute=lambda size: Contribution(reference_arcsec=size * wrong),
        cells=tuple(CellTruth(order=str(k), frame="polygon") for k in range(1, 12)),
        parameters={},
    )


def run_to_run_eccentricity(setting: Setting, rng: np.random.Generator) -> Defect:
    """The grating seats anew in each run."""
    runs, which = np.unique(setting.schedule.run, return_inverse=True)
    seats = (rng.normal(size=runs.size) + 1j * rng.normal(size=runs.size))[which]
    return Defect(
        name="run_to_run_eccentricity",
        in_library=True,
        kind="random",
        contribute=lambda size: Contribution(centre_mm=setting.mm(size) * seats),
        cells=(CellTruth(order="1", time="between_runs"),),
        parameters={},
    )


def noise_growth(setting: Setting, rng: np.random.Generator) -> Defect:
    """Scatter that grows with temperature, speed or load: whichever changes in this campaign."""
    schedule = setting.schedule
    choices = {
        "temperature": 0.5 * (1.0 + setting.relative_temperature),
        "speed": np.abs(schedule.velocity_deg_s),
        "load": schedule.load_nm - schedule.load_nm.min(),
    }
    changing = [name for name, values in choices.items() if float(np.ptp(values)) > 1e-9]
    name = str(rng.choice(changing))
    growth = choices[name] / float(np.sqrt(np.mean(choices[name] ** 2)))
    cell = {
        "temperature": CellTruth(order="0", temperature="linear", moment="variance"),
        "speed": CellTruth(order="0", speed="linear", moment="variance"),
        "load": CellTruth(order="0", load="linear", moment="variance"),
    }[name]
    return Defect(
        name="noise_growth",
        in_library=True,
        kind="variance",
        contribute=lambda size: Contribution(scatter_arcsec=abs(size) * growth),
        cells=(cell,),
        parameters={},
    )
