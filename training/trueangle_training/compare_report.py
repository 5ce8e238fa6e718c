"""The tables of `trueangle compare`, and `compare.json`.

`compare.json`, format 1 (all errors in arcsec, intervals 95 % over resampled runs, over resampled
readings where there is one run):

- `format`, `calibration` {`file`, `sha256`, `readings`, `runs`, `temperatures_c` (empty where none were
  measured)}, `seed`, `simulated` (bool)
- `repeatability_arcsec`, `reference_standard_uncertainty_arcsec`: number or null where not known
- `noise_arcsec`: what `coverage_2u` adds to the method's uncertainty, number or null; `noise_from`: `repeats` (it
  is the repeatability), `fit` (what a smooth fit leaves, where no place is read twice) or null
- `datum` {`angle_deg`, `statement`, `drift_rms_arcsec` (null unless simulated)}
- `oracle_rmse_arcsec`: null unless simulated
- `refused`: list of {`method`, `reason`}; `notes`: list of text
- `warnings`: list of text, readings that are conspicuous and were not left out
- `hidden_nodes`: {method: {`setting`, `temperatures` [text], `points`: list of {`hidden_nodes`, `rmse`,
  `standard_error` (over the temperatures), `at_temperature` [number]}}}, at left-out temperatures
- `methods`: list, the best at left-out temperatures first, the baselines (`none`: no correction) among them, of
  {`name`, `seconds`,
   `held_out`: {kind: {`rmse`, `low`, `high`, `largest`, `coverage_2u` (or null), `not_left_out` [text],
                       `minus_best` {`value`, `low`, `high`} or null}},
   `seam_jump`, `between_faces_rms`,
   `truth`: null or {`rmse`, `largest`, `seam_rmse`, `over_oracle`, `coverage_2u` (or null)},
   `in_sample_rmse`}
  with the kinds of `HeldOutKind`.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trueangle.contract.calibration import Campaign
from trueangle_training.dataset import TrainingSet
from trueangle_training.evaluation.baselines import EVERY_TEMPERATURE, NONE
from trueangle_training.evaluation.bootstrap import Estimate
from trueangle_training.evaluation.comparison import Comparison, HeldOutScore, MethodScore
from trueangle_training.evaluation.datum_drift import shows_datum_drift
from trueangle_training.evaluation.held_out import FEWEST_PLACES, HeldOutKind, temperature_groups
from trueangle_training.evaluation.reading_noise import ReadingNoise
from trueangle_training.hidden_node_sweep import HiddenNodeSweep, sweep_json
from trueangle_training.methods import distinct_angle_count

FORMAT = 1
DATUM_STATEMENT = "errors are counted from the datum at the same temperature; "
DATUM_UNSEEN = (
    "a drift that is the same at all angles cannot be seen by runs that are zeroed one by one at each temperature "
    "(Eq. 11)"
)
DATUM_SHOWN = (
    "runs of different temperatures share a zero and show how the datum itself drifts; no correction contains that"
)
KIND_TITLES = {
    HeldOutKind.TEMPERATURE: "Each temperature in turn left out of the training",
    HeldOutKind.RUN: "One run of every temperature in turn left out",
    HeldOutKind.FACE: "Places left out at all temperatures one by one, the last before the seam among them",
}

BASELINES = {
    NONE: "no correction",
    "angle-only": "harmonics of the angle, temperature ignored",
    EVERY_TEMPERATURE: "harmonics of the angle from all temperatures together",
    "harmonics-poly": "harmonics times a polynomial of temperature, as the paper's authors had it in 2019",
}
NEEDED = {
    HeldOutKind.TEMPERATURE: "three temperatures",
    HeldOutKind.RUN: "two runs at a temperature",
    HeldOutKind.FACE: f"{FEWEST_PLACES} places, such as repeats shifted by a third of the face pitch",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedData:
    """What was compared on."""

    campaign: Campaign
    data: TrainingSet
    noise: ReadingNoise | None
    """Of one reading; None: not known."""
    reference_arcsec: float | None
    """Standard uncertainty of the reference; None: not stated."""
    datum_drift_arcsec: float | None
    """RMS of E(datum, T) about its mean; None: not simulated."""
    seed: int
    sweeps: tuple[HiddenNodeSweep, ...] = ()
    """Of the methods that have hidden nodes."""


def report_lines(compared: ComparedData, comparison: Comparison) -> Iterator[str]:
    """The terminal's text."""
    readings = compared.data.readings
    at_c = ", ".join(f"{each:.1f}" for each in _temperatures_c(compared))
    measured = f"at {at_c} degC" if at_c else "without temperatures"
    runs = np.unique(readings.run).size
    yield f"{compared.campaign.source}: {len(readings)} readings in {runs} run{'s' if runs > 1 else ''} {measured}"
    yield from _floor_lines(compared)
    yield from (f"baseline {name}: {meaning}" for name, meaning in BASELINES.items() if _has(comparison, name))
    for kind, title in KIND_TITLES.items():
        yield from _kind_lines(kind, title, compared, comparison)
    yield from _shape_lines(compared, comparison)
    yield from _truth_lines(compared, comparison)
    yield from _sweep_lines(compared.sweeps)
    yield ""
    yield "In-sample RMSE, arcsec, each run's mean taken off: ranks methods wrongly, here for completeness"
    for score in comparison.scores:
        yield f"  {score.name:<16}{score.in_sample_rmse_arcsec:7.3f}"
    if comparison.refused:
        yield ""
    names_by_reason: dict[str, list[str]] = {}
    for name, reason in comparison.refused:
        names_by_reason.setdefault(reason, []).append(name)
    for reason, names in names_by_reason.items():
        yield f"not suited: {', '.join(names)}: {reason}"
    for note in compared.data.notes:
        yield f"note: {note}"


def _has(comparison: Comparison, name: str) -> bool:
    return any(score.name == name for score in comparison.scores)


def _temperatures_c(compared: ComparedData) -> list[float]:
    """Empty where none were measured."""
    readings = compared.data.readings
    if compared.campaign.temperature_c is None:
        return []
    group = temperature_groups(readings)
    return [float(readings.temperature_c[group == each].mean()) for each in np.unique(group)]


def _floor_lines(compared: ComparedData) -> Iterator[str]:
    noise = compared.noise
    if noise is None:
        yield "noise of one reading: not known, neither from repeats nor from a fit: no coverage"
    elif noise.from_repeats:
        yield (
            f"repeatability of one reading: {noise.sigma_arcsec:.3f} arcsec, the floor of every figure "
            "of left-out readings"
        )
    else:
        yield (
            f"noise of one reading: {noise.sigma_arcsec:.3f} arcsec from what the fit of linear leaves, as no "
            "place is read twice at one temperature: coverage rests on it"
        )
    if compared.reference_arcsec is None:
        yield "standard uncertainty of the reference: not stated, so nothing here is an uncertainty of the angle"
    else:
        yield (
            f"standard uncertainty of the reference: {compared.reference_arcsec:.3f} arcsec; no corrected angle "
            "is better than that, whatever residual is printed"
        )
    yield _datum_statement(compared) + (
        "" if compared.datum_drift_arcsec is None else f": here {compared.datum_drift_arcsec:.2f} arcsec RMS"
    )


def _datum_statement(compared: ComparedData) -> str:
    return DATUM_STATEMENT + (DATUM_SHOWN if shows_datum_drift(compared.data.readings) else DATUM_UNSEEN)


def _kind_lines(kind: HeldOutKind, title: str, compared: ComparedData, comparison: Comparison) -> Iterator[str]:
    scored = [score for score in comparison.scores if score.score(kind) is not None]
    if not scored:
        yield ""
        yield f"{title}: not possible here; it takes {NEEDED[kind]}"
        return
    yield ""
    over = "runs" if np.unique(compared.data.readings.run).size > 1 else "readings"
    yield f"{title}: RMSE [95 % over {over}], largest, arcsec; runs centred"
    yield f"  {'method':<16}{'RMSE':>7} {'':<18}{'largest':>8}  {'minus the best [95 %]':<28}{'within 2u':<10}"
    for score in scored:
        held_out = score.score(kind)
        assert held_out is not None  # noqa: S101 - chosen so above
        yield "  " + _held_out_line(score, held_out, compared.reference_arcsec)
    for score in scored:
        held_out = score.score(kind)
        for text in () if held_out is None else held_out.refused:
            yield f"  {score.name} without {text}"


def _held_out_line(score: MethodScore, held_out: HeldOutScore, reference_arcsec: float | None) -> str:
    over = score.over_best[score.held_out.index(held_out)]
    difference = "-" if over is None else f"{over.value:+.3f} [{over.low:+.3f}, {over.high:+.3f}]"
    interval = f"[{held_out.rmse.low:.3f}, {held_out.rmse.high:.3f}]"
    coverage = "-" if held_out.coverage is None else f"{100 * held_out.coverage:.1f} %"
    line = f"{score.name:<16}{held_out.rmse.value:7.3f} {interval:<18}{held_out.largest_arcsec:8.2f}  "
    return line + f"{difference:<28}{coverage:<10}" + _below_reference(held_out.rmse.value, reference_arcsec)


def _below_reference(figure_arcsec: float, reference_arcsec: float | None) -> str:
    if reference_arcsec is None or figure_arcsec >= reference_arcsec:
        return ""
    return f"below the reference's own {reference_arcsec:.3f}: the angle is not that good"


def _shape_lines(compared: ComparedData, comparison: Comparison) -> Iterator[str]:
    highest = (distinct_angle_count(compared.data.readings.angle_deg) - 1) // 2
    yield ""
    yield (
        "What the models do where nothing was measured, arcsec; a joint has no jump at the seam, and departs "
        f"between the places from the harmonics up to {highest} that they show only as far as it has higher ones"
    )
    yield f"  {'method':<16}{'jump at the seam':>17}{'departure between faces, RMS':>31}{'s a training':>14}"
    for score in comparison.scores:
        shape = score.shape
        figures = f"{shape.seam_jump_arcsec:17.3f}{shape.between_faces_rms_arcsec:31.3f}{score.seconds:14.2f}"
        yield f"  {score.name:<16}{figures}"


def _truth_lines(compared: ComparedData, comparison: Comparison) -> Iterator[str]:
    if comparison.oracle is None:
        return
    yield ""
    best = comparison.oracle
    yield (
        "True error on a 0.05 deg x 0.5 degC grid, arcsec, without noise; the oracle, least squares that know the "
        f"effects' shapes: RMSE {best.rmse_arcsec:.3f}, largest {best.largest_arcsec:.2f}"
    )
    header = f"{'RMSE':>7}{'/oracle':>9}{'largest':>9}{'RMSE after the last face':>26}  {'within 2u':<10}"
    yield f"  {'method':<16}{header}"
    for score in comparison.scores:
        truth = score.truth
        if truth is None:
            continue
        ratio = 0.0 if truth.over_oracle is None else truth.over_oracle
        coverage = "-" if truth.coverage is None else f"{100 * truth.coverage:.1f} %"
        figures = f"{truth.rmse_arcsec:7.3f}{ratio:9.2f}{truth.largest_arcsec:9.2f}{truth.seam_rmse_arcsec:26.3f}"
        note = _below_reference(truth.rmse_arcsec, compared.reference_arcsec)
        yield f"  {score.name:<16}{figures}  {coverage:<10}{note}"


def _sweep_lines(sweeps: tuple[HiddenNodeSweep, ...]) -> Iterator[str]:
    if not sweeps:
        return
    yield ""
    yield "Hidden nodes, each temperature in turn left out: RMSE ± standard error over the temperatures, arcsec"
    for sweep in sweeps:
        points = "   ".join(
            f"{point.hidden_nodes}: {point.rmse_arcsec:.3f} ± {point.standard_error_arcsec:.3f}"
            for point in sweep.points
        )
        yield f"  {sweep.method:<16}{points}"
        yield f"  {'':<16}({sweep.setting})"


def report_json(compared: ComparedData, comparison: Comparison) -> bytes:
    """The document described above."""
    readings, noise = compared.data.readings, compared.noise
    repeatability = noise.sigma_arcsec if noise is not None and noise.from_repeats else None
    document = {
        "format": FORMAT,
        "calibration": {
            "file": compared.campaign.source,
            "sha256": compared.campaign.sha256,
            "readings": len(readings),
            "runs": int(np.unique(readings.run).size),
            "temperatures_c": _temperatures_c(compared),
        },
        "seed": compared.seed,
        "simulated": comparison.oracle is not None,
        "repeatability_arcsec": repeatability,
        "noise_arcsec": None if noise is None else noise.sigma_arcsec,
        "noise_from": None if noise is None else "repeats" if noise.from_repeats else "fit",
        "reference_standard_uncertainty_arcsec": compared.reference_arcsec,
        "datum": {
            "angle_deg": compared.data.datum_deg,
            "statement": _datum_statement(compared),
            "drift_rms_arcsec": compared.datum_drift_arcsec,
        },
        "oracle_rmse_arcsec": None if comparison.oracle is None else comparison.oracle.rmse_arcsec,
        "refused": [{"method": name, "reason": reason} for name, reason in comparison.refused],
        "notes": list(compared.data.notes),
        "warnings": list(compared.data.warnings),
        "hidden_nodes": {sweep.method: sweep_json(sweep) for sweep in compared.sweeps},
        "methods": [_method_json(score) for score in comparison.scores],
    }
    return (json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _method_json(score: MethodScore) -> dict[str, object]:
    truth = score.truth
    return {
        "name": score.name,
        "seconds": score.seconds,
        "held_out": {
            held_out.kind.value: {
                **_estimate_json("rmse", held_out.rmse),
                "largest": held_out.largest_arcsec,
                "coverage_2u": held_out.coverage,
                "not_left_out": list(held_out.refused),
                "minus_best": None if over is None else _estimate_json("value", over),
            }
            for held_out, over in zip(score.held_out, score.over_best, strict=True)
        },
        "seam_jump": score.shape.seam_jump_arcsec,
        "between_faces_rms": score.shape.between_faces_rms_arcsec,
        "truth": None
        if truth is None
        else {
            "rmse": truth.rmse_arcsec,
            "largest": truth.largest_arcsec,
            "seam_rmse": truth.seam_rmse_arcsec,
            "over_oracle": truth.over_oracle,
            "coverage_2u": truth.coverage,
        },
        "in_sample_rmse": score.in_sample_rmse_arcsec,
    }


def _estimate_json(name: str, estimate: Estimate) -> dict[str, float]:
    return {name: estimate.value, "low": estimate.low, "high": estimate.high}
