"""Findings made by hand, for tests of what is written of them."""

from dataclasses import replace

import numpy as np

from trueangle_training.diagnosis.curves import Curves
from trueangle_training.diagnosis.findings import (
    Carried,
    Cause,
    Conclusion,
    DataFault,
    Drifting,
    EndTask,
    Estimate,
    Findings,
    Gap,
    Place,
    PlanSight,
    Seen,
    Step,
    Subject,
    Unexplained,
)
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.effect import Nature

HOSTILE = "<script>alert(1)</script>"
SUBJECT = Subject(
    campaign=f"runs {HOSTILE}.csv",
    campaign_sha256="a" * 64,
    readings=230,
    runs=10,
    joint=f"elbow {HOSTILE}",
    modelled_effects=("eccentricity", "grating_tilt"),
)
HYSTERESIS = Cause(
    effect="hysteresis",
    probability=0.983,
    members=("hysteresis",),
    class_probability=0.99,
    kind=Nature.MEAN,
    parameters={"amplitude_arcsec": Estimate(value=-2.31, standard_uncertainty=0.12)},
    closes=0.62,
    closes_interval=(0.55, 0.69),
    label="order 1, odd in the direction",
    cell=Cell(order="1", direction="odd"),
)
CLASS_OF_THREE = Cause(
    effect="graduation_error",
    probability=0.55,
    members=("graduation_error", "subdivision_error", "reference_artefact"),
    class_probability=0.95,
    kind=Nature.MEAN,
    parameters={},
    closes=0.3,
    cell=Cell(order="13"),
)
PLACES = (
    Place(cell=Cell(order="1", direction="odd"), share=0.61, p_value=0.0005, significant=True),
    Place(cell=Cell(order="13"), share=0.29, p_value=0.004, significant=True),
    Place(cell=Cell(order="2", temperature="linear"), share=0.004, p_value=0.7, significant=False),
    Place(cell=Cell(order="1", load="linear"), share=0.0, p_value=None, significant=False, runs_needed=8),
)
GAP = Gap(
    rmse_shipped_arcsec=3.91,
    rmse_recalibrated_arcsec=2.42,
    rmse_explained_arcsec=0.71,
    floor_arcsec=0.64,
    parametric_share=0.62,
    structural_share=0.353,
    floor_share=0.027,
    closure=0.93,
    closure_interval=(0.88, 0.96),
    ceiling=0.97,
    random_control=0.03,
)
NAMED = Findings(
    subject=SUBJECT,
    conclusion=Conclusion.NAMED,
    causes=(HYSTERESIS, CLASS_OF_THREE),
    where=PLACES,
    gap=GAP,
    waterfall=(
        Step(effect="hysteresis", closure=0.63, interval=(0.55, 0.7)),
        Step(effect="graduation_error", closure=0.93, interval=None),
    ),
    end_task=EndTask(
        method="linear",
        compensable=False,
        missing_input="the direction of approach",
        none_arcsec=51.2,
        simulator_arcsec=2.6,
        explained_arcsec=2.5,
        oracle_arcsec=2.45,
    ),
    drifting=(Drifting(effect="eccentricity", over="direction", p_value=0.0004),),
    invisible=("read_latency",),
    not_testable={"load_deflection": "the campaign lacks load_nm"},
    next_measurement="Measure the polygon once more, turned by a third of a face pitch.",
    notes=(f"column {HOSTILE} is unknown and was ignored",),
)
UNKNOWN = replace(
    NAMED,
    conclusion=Conclusion.UNKNOWN,
    causes=(),
    waterfall=(),
    unexplained=Unexplained(significant=True, nearest_effect="thermal_graduation", nearest_share=0.41),
)
NONE = replace(
    NAMED,
    conclusion=Conclusion.NONE,
    causes=(),
    waterfall=(),
    where=tuple(replace(place, significant=False) for place in PLACES),
    gap=replace(GAP, closure=None, closure_interval=None, ceiling=None, random_control=None),
    end_task=replace(NAMED.end_task, compensable=True, missing_input=None),
)
DATA_FAULT = Findings(
    subject=SUBJECT,
    conclusion=Conclusion.DATA_FAULT,
    data_faults=(DataFault(kind="direction_swapped", rows=tuple(range(2, 92)), text=f"odd {HOSTILE} rows"),),
)
INSUFFICIENT = Findings(
    subject=SUBJECT, conclusion=Conclusion.INSUFFICIENT, next_measurement="Two more runs at another temperature."
)
ALL = (NAMED, UNKNOWN, NONE, DATA_FAULT, INSUFFICIENT)
SIGHT = PlanSight(
    subject=SUBJECT,
    effects=(
        Seen(effect="hysteresis", visible_fraction=0.8),
        Seen(effect="read_latency", visible_fraction=1e-9, reason="all readings stand still"),
        Seen(effect="load_deflection", visible_fraction=None, reason="the campaign lacks load_nm"),
    ),
    pairs=(Carried(effect="hysteresis", by="windup", fraction=0.97),),
    testable=("hysteresis",),
    invisible=("read_latency",),
    not_testable={"load_deflection": "the campaign lacks load_nm"},
    next_measurement="",
)


def made_curves(readings: int = 230) -> Curves:
    """Hysteresis of 2 arcsec before, noise after."""
    rng = np.random.default_rng(0)
    angle_deg = rng.uniform(0.0, 360.0, readings)
    direction = np.where(np.arange(readings) % 2, 1.0, -1.0)
    noise = rng.normal(0.0, 0.6, readings)
    return Curves(
        angle_deg=angle_deg,
        run=np.arange(readings) // 23,
        recalibrated_arcsec=noise + 2.0 * direction * np.cos(np.radians(angle_deg)),
        explained_arcsec=noise,
        temperature_c=np.linspace(10.0, 40.0, readings),
        direction=direction,
    )
