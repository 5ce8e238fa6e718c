"""Campaigns for the tests of the gap: two harmonics, coloured noise, and one pattern more where asked."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.calibration import Campaign, campaign_to_csv, read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import Joint, joint_from_document
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.effects import EFFECTS

Floats = NDArray[np.float64]
Pattern = Callable[[Floats, Floats, NDArray[np.int64]], Floats]
"""Of the angle in radians, the temperature in degC and the run: arcsec."""

FACES, REPEATS = 23, 3
TEMPERATURES_C = (25.0, 10.0, 40.0, 20.0, 35.0, 15.0, 30.0)
"""Not in order, so that the temperature is no clock."""
SIGMA_ARCSEC = 0.5
COUNTS = 3_276_800


def joint(effects: dict[str, object] | None = None) -> Joint:
    """Eccentricity, tilt and thermal eccentricity, all to be calibrated."""
    listed = {"eccentricity": {}, "grating_tilt": {}, "thermal_eccentricity": {}} if effects is None else effects
    plain = {
        "schema_version": 1,
        "encoder": {"lines_per_rev": 16384, "counts_per_rev": COUNTS},
        "reference": {"kind": "polygon", "faces": FACES},
        "effects": listed,
    }
    return joint_from_document(document_from_plain(plain, source="joint.yaml", path=""))


def coloured(count: int, rng: np.random.Generator, *, memory: float = 4.0, share: float = 0.3) -> Floats:
    """White noise with heavy tails and a first-order autoregression of `memory` readings, variance 1."""
    white = rng.standard_t(6, size=count) / np.sqrt(1.5)
    kept = np.exp(-1.0 / memory)
    slow = np.empty(count)
    state = rng.normal()
    for i in range(count):
        slow[i] = state
        state = kept * state + np.sqrt(1.0 - kept**2) * rng.normal()
    return np.sqrt(1.0 - share) * white + np.sqrt(share) * slow


def campaign(
    seed: int,
    pattern: Pattern | None = None,
    *,
    sigma_arcsec: float = SIGMA_ARCSEC,
    directions: tuple[int, ...] = (1,),
    temperatures_c: tuple[float, ...] = TEMPERATURES_C,
    repeats: int = REPEATS,
    colour: float = 0.3,
) -> Campaign:
    """Runs over a 23-face polygon, each with its own zero; `colour`: part of the noise with a memory."""
    rng = np.random.default_rng(seed)
    columns: dict[str, list[Floats]] = {name: [] for name in ("angle", "error", "t", "run", "time", "dir", "face")}
    clock_s, run = 0.0, 0
    for set_c in temperatures_c:
        clock_s += 4 * 3600.0
        for _ in range(repeats):
            for direction in directions:
                run += 1
                stop = np.arange(FACES) if direction > 0 else np.arange(FACES)[::-1]
                theta = 2 * np.pi * stop / FACES
                temperature = set_c + rng.uniform(-0.1, 0.1) + rng.normal(0.0, 0.02, FACES)
                error = (
                    20.0 * np.cos(theta - 1.0) + 3.0 * np.cos(2 * theta) + 0.1 * (temperature - 20) * np.sin(theta)
                )
                runs = np.full(FACES, run)
                if pattern is not None:
                    error = error + pattern(theta, temperature, runs)
                error = error + sigma_arcsec * coloured(FACES, rng, share=colour)
                columns["angle"].append(
                    np.rint((stop * 360.0 / FACES + error / 3600) * COUNTS / 360) * 360 / COUNTS
                )
                columns["error"].append(error - error[0])
                columns["t"].append(temperature)
                columns["run"].append(runs.astype(np.float64))
                columns["time"].append(clock_s + 15.0 * np.arange(FACES, dtype=np.float64))
                columns["dir"].append(np.full(FACES, direction, dtype=np.float64))
                columns["face"].append((stop + 1).astype(np.float64))
                clock_s += 15.0 * FACES + 60.0
    made = {name: np.concatenate(parts) for name, parts in columns.items()}
    whole = {name: made[name].astype(np.int64) for name in ("run", "dir", "face")}
    read = Campaign(
        angle_deg=made["angle"],
        error_arcsec=made["error"],
        run=whole["run"],
        zero_group=whole["run"],
        row=np.arange(2, made["run"].size + 2),
        source="measured.csv",
        sha256="",
        temperature_c=made["t"],
        time_s=made["time"],
        direction=whole["dir"],
        velocity_deg_s=np.zeros(made["run"].size),
        load_nm=np.ones(made["run"].size),
        face=whole["face"],
        polygon_offset=np.zeros(made["run"].size, dtype=np.int64),
    )
    return read_campaign(campaign_to_csv(read).encode(), source="measured.csv")


def problem(made: Campaign, of_joint: Joint | None = None, *, shapes: bool = False) -> Problem:
    """Laid out, with the library's shapes or without any."""
    return problem_of(made, of_joint or joint(), library=EFFECTS if shapes else {})
