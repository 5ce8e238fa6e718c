"""Does the further measurement that a diagnosis recommends bring what its text says?

    python -m tests.benchmarks.next_measurement_trial --seeds 6

On the paper's plan (one direction, no load, standing still) campaigns are simulated with one effect that the
simulator of the diagnosis lacks, its RMS outside what is re-calibrated twice the noise of one reading, which is
coloured. Where the answer is a class of several effects, the recommended measurement is laid out as the
recommendation lays it out, simulated on the same joint, and the whole is diagnosed again. Counted: whether the
true effect stays in the class, whether what the text says comes true, how large the class is before and after, and
wrong names of a probability of 0.9 or more. Effects that the plan hides are as large in the readings that are to
show them; there it is counted how often they are found.

Simulator and diagnosis share the library's formulas: what is tried is the recommendation, not the physics.
"""

import argparse
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from multiprocessing import Pool
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from tests.training.gap_campaigns import coloured

from trueangle.contract.calibration import Campaign, campaign_to_csv, read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import Joint, joint_from_document, plan_from_document
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.blind_check.intervals import exact_binomial
from trueangle_training.diagnosis.attribution import attribute
from trueangle_training.diagnosis.curve_checks import other_joint_faults
from trueangle_training.diagnosis.data_checks import data_checks
from trueangle_training.diagnosis.design_check import Design, design_check
from trueangle_training.diagnosis.found_effect import Curve, found_effect
from trueangle_training.diagnosis.further_readings import extended
from trueangle_training.diagnosis.next_measurement import next_measurement
from trueangle_training.diagnosis.problem import Problem, problem_of, recalibration_span
from trueangle_training.diagnosis.verdict import Cause, verdict_of
from trueangle_training.effects.conditions import Conditions, conditions_of
from trueangle_training.simulator.campaign import simulate_campaign
from trueangle_training.simulator.joint import simulated_joint

Floats = NDArray[np.float64]
Settings = dict[str, Any]
Shape = Callable[[float], Settings]
"""Settings of an effect from its size."""

NOISE_ARCSEC = 0.63
FACES = 23
CONFIDENT = 0.9
LISTED: dict[str, Settings] = {
    "eccentricity": {"amplitude_arcsec": 40.0, "phase_deg": -64.0},
    "grating_tilt": {"amplitude_arcsec": 7.0, "phase_deg": 90.0},
    "thermal_eccentricity": {"amplitude_arcsec_per_k": 0.2, "phase_deg": 81.0},
}
"""What the joint has and the simulator of the diagnosis knows of, unless it is the effect that is tried."""

UNLISTED = {"hysteresis": ("eccentricity", "grating_tilt")}
"""What would take up all of an effect that the plan shows; of other effects they themselves."""


def _harmonic(name: str, order: int, rng: np.random.Generator) -> Callable[[float], list[Settings]]:
    phase_deg = float(rng.choice([0.0, 180.0]) if order == 0 else rng.uniform(-180.0, 180.0))
    return lambda size: [{"order": order, name: size, "phase_deg": phase_deg}]


def _wave(rng: np.random.Generator) -> Shape:
    phase_deg = float(rng.uniform(-180.0, 180.0))
    return lambda size: {"amplitude_arcsec": size, "phase_deg": phase_deg}


def _graduation(rng: np.random.Generator) -> Shape:
    waves = _harmonic("amplitude_arcsec", int(rng.integers(3, 10)), rng)
    return lambda size: {"harmonics": waves(size)}


def _defect(rng: np.random.Generator) -> Shape:
    fwhm_deg = float(rng.uniform(5.0, 14.0))
    stop_deg = DEG_PER_TURN / FACES * float(rng.integers(1, FACES))
    centre_deg = stop_deg + float(rng.uniform(-0.3, 0.3)) * fwhm_deg
    return lambda size: {"defects": [{"centre_deg": centre_deg, "fwhm_deg": fwhm_deg, "amplitude_arcsec": size}]}


def _faces(rng: np.random.Generator) -> Shape:
    deviations = rng.normal(size=FACES)
    return lambda size: {"faces_arcsec": [float(each) for each in size * deviations]}


def _wobble(rng: np.random.Generator) -> Shape:
    per_turn = float(rng.uniform(0.35, 0.45) if rng.random() < 0.5 else rng.integers(2, 5) + rng.uniform(0.2, 0.8))
    phase_deg = float(rng.uniform(-180.0, 180.0))
    return lambda size: {"wobbles": [{"per_turn": per_turn, "amplitude_arcsec": size, "phase_deg": phase_deg}]}


def _windup(rng: np.random.Generator) -> Shape:
    travel_deg = float(np.exp(rng.uniform(np.log(10.0), np.log(100.0))))
    return lambda size: {"amplitude_arcsec": size, "travel_deg": travel_deg}


def _drift(rng: np.random.Generator) -> Shape:
    time_constant_s = float(np.exp(rng.uniform(np.log(60.0), np.log(3000.0))))
    return lambda size: {"amplitude_arcsec": size, "time_constant_s": time_constant_s}


def _hysteresis(rng: np.random.Generator) -> Shape:
    waves = _harmonic("amplitude_arcsec", int(rng.integers(1, 3)), rng)
    return lambda size: {"harmonics": waves(size)}


def _even_hysteresis(rng: np.random.Generator) -> Shape:
    waves = _harmonic("amplitude_arcsec", 0, rng)
    return lambda size: {"harmonics": waves(size)}


def _load(rng: np.random.Generator) -> Shape:
    waves = _harmonic("amplitude_arcsec_per_nm", int(rng.integers(0, 3)), rng)
    return lambda size: {"harmonics": waves(size)}


def _subdivision(rng: np.random.Generator) -> Shape:
    phases_deg = [float(each) for each in rng.uniform(-180.0, 180.0, size=2)]
    ratio = float(rng.uniform(0.3, 1.0))
    return lambda size: {
        "harmonics": [
            {"per_line": 1, "amplitude_arcsec": size, "phase_deg": phases_deg[0]},
            {"per_line": 2, "amplitude_arcsec": ratio * size, "phase_deg": phases_deg[1]},
        ]
    }


def _heating(rng: np.random.Generator) -> Shape:
    waves = _harmonic("amplitude_arcsec_per_deg_s", int(rng.integers(0, 3)), rng)
    time_constant_s = float(np.exp(rng.uniform(np.log(200.0), np.log(3000.0))))
    return lambda size: {"time_constant_s": time_constant_s, "harmonics": waves(size)}


def _latency(rng: np.random.Generator) -> Shape:
    sign = float(rng.choice([-1.0, 1.0]))
    return lambda size: {"latency_s": sign * size}


SEEN: dict[str, Callable[[np.random.Generator], Shape]] = {
    "eccentricity": _wave,
    "grating_tilt": _wave,
    "graduation_error": _graduation,
    "localized_defect": _defect,
    "reference_artefact": _faces,
    "bearing_wobble": _wobble,
    "windup": _windup,
    "index_drift": _drift,
    "hysteresis": _hysteresis,
    "subdivision_error": _subdivision,
    "self_heating": _heating,
}
HIDDEN: dict[str, Callable[[np.random.Generator], Shape]] = {
    "read_latency": _latency,
    "load_deflection": _load,
    "hysteresis": _even_hysteresis,
}
"""Of hysteresis the part that does not depend on the angle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What came of one campaign."""

    effect: str
    hidden: bool
    seed: int
    asked: bool
    """Whether there was a class of several effects, or a hidden effect, to measure for."""
    before: tuple[str, ...]
    """The class that was asked about, else that of the first cause."""
    said: str
    """Verdict and causes before and after."""
    measured: str = ""
    """The recommended measurement; "": none."""
    promised: tuple[str, ...] = ()
    """What the text says it tells from the first of the class, or of a hidden effect what it says it shows."""
    after: tuple[str, ...] = ()
    """Class of the first cause of the whole."""
    confident_wrong: bool = False

    @property
    def tried(self) -> bool:
        """Whether a measurement was taken, for a class that holds the true effect."""
        return bool(self.measured) and (self.hidden or self.effect in self.before)

    @property
    def kept(self) -> bool:
        """The true effect is in the class after."""
        return self.effect in self.after

    @property
    def promising(self) -> bool:
        """Whether the text says anything of the true effect."""
        return self.tried and (self.effect in self.promised or self.effect == self.before[0])

    @property
    def come_true(self) -> bool:
        """A hidden effect is in the first class; the first named has lost what it was told from; or the true
        effect, told from the first named, has taken its place."""
        if self.hidden:
            return self.kept
        if self.effect == self.before[0]:
            return self.kept and not set(self.promised) & set(self.after)
        return bool(self.after) and self.after[0] == self.effect


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """Of one diagnosis what the trial needs."""

    problem: Problem
    design: Design
    asked: tuple[str, ...] = ()
    """First class of several effects."""
    found: Curve | None = None
    """Its first effect as found."""
    causes: tuple[Cause, ...] = ()
    said: str


def _joint(effects: dict[str, Settings]) -> Joint:
    plain = {
        "schema_version": 1,
        "encoder": {"lines_per_rev": 16384, "counts_per_rev": 3276800},
        "reference": {"kind": "polygon", "faces": FACES},
        "noise": {"repeatability_arcsec": NOISE_ARCSEC},
        "effects": effects,
    }
    return joint_from_document(document_from_plain(plain, source="joint.yaml", path=""))


def _paper_plan(joint: Joint, seed: int) -> Conditions:
    """At the true angles of the stops, with each run's own temperature."""
    text = files("trueangle_training.examples").joinpath("plan.yaml").read_text()
    plan = plan_from_document(document_from_plain(yaml.safe_load(text), source="plan.yaml", path=""))
    made = conditions_of(simulate_campaign(simulated_joint(joint), plan, seed), joint)
    return replace(made, angle_deg=np.rint(made.angle_deg * FACES / DEG_PER_TURN) * (DEG_PER_TURN / FACES))


def _noise_arcsec(conditions: Conditions, rng: np.random.Generator) -> Floats:
    """Run by run: the readings of the plan keep their noise when others come after them."""
    runs = np.unique(conditions.run)
    return NOISE_ARCSEC * np.concatenate([coloured(int(np.sum(conditions.run == run)), rng) for run in runs])


def _measured(conditions: Conditions, true: Joint, seed: int) -> Campaign:
    """As a file has it; `conditions` hold the true angles."""
    simulated = simulated_joint(true)
    noise_arcsec = _noise_arcsec(conditions, np.random.default_rng([seed, 1]))
    counts = simulated.indicated_counts(conditions, noise_arcsec, lambda name: np.random.default_rng([seed, 2]))
    angle_deg = counts.astype(np.float64) * (DEG_PER_TURN / true.encoder.counts_per_rev)
    error_arcsec = (angle_deg - conditions.angle_deg) * ARCSEC_PER_DEG
    error_arcsec += simulated.reference_arcsec(conditions, lambda name: np.random.default_rng([seed, 3]))
    _, first, group = np.unique(conditions.zero_group, return_index=True, return_inverse=True)
    direction = conditions.direction
    campaign = Campaign(
        angle_deg=angle_deg,
        error_arcsec=error_arcsec - error_arcsec[first][group],
        run=conditions.run,
        zero_group=conditions.zero_group,
        row=np.arange(2, len(conditions) + 2),
        source="trial.csv",
        sha256="",
        temperature_c=conditions.temperature_c,
        time_s=conditions.time_s,
        direction=None if direction is None else direction.astype(np.int64),
        velocity_deg_s=conditions.velocity_deg_s,
        load_nm=conditions.load_nm,
        face=conditions.face,
        polygon_offset=conditions.polygon_offset,
    )
    return read_campaign(campaign_to_csv(campaign).encode(), source="trial.csv")


def _size(conditions: Conditions, joint: Joint, effect: str, shape: Shape, wanted: float, since: int) -> float:
    """At which the part outside the re-calibratable span has the wanted RMS over the readings from `since` on."""
    one = _joint({effect: shape(1.0)})
    simulated = simulated_joint(one)
    curve = next(iter(simulated.effects)).settings.error_arcsec(conditions, one, None)
    modelled, _, drift = recalibration_span(conditions, joint)
    offsets = (conditions.zero_group[:, None] == np.unique(conditions.zero_group)).astype(np.float64)
    span = np.column_stack([offsets, drift, modelled])
    left = curve - span @ np.linalg.lstsq(span, curve, rcond=1e-8)[0]
    return wanted / float(np.sqrt(np.mean(left[since:] ** 2)))


def _answer(campaign: Campaign, joint: Joint) -> Answer:
    """As `trueangle diagnose` has it, without closure and end task."""
    problem = problem_of(campaign, joint)
    design = design_check(problem.without_errors())
    faults = data_checks(campaign, joint).faults or other_joint_faults(problem)
    if faults:
        return Answer(problem=problem, design=design, said=", ".join(fault.kind for fault in faults))
    attribution = attribute(problem)
    verdict = verdict_of(problem, attribution, design)
    causes = ", ".join(f"{cause.effect} {cause.probability:.2f}" for cause in verdict.causes)
    several = next((cause for cause in verdict.causes if len(cause.effect_class) > 1), None)
    members = [] if several is None else [attribution.members[place] for place in several.members]
    return Answer(
        problem=problem,
        design=design,
        asked=() if several is None else several.effect_class,
        found=found_effect(problem, members),
        causes=verdict.causes,
        said=f"{verdict.kind.value} ({causes})",
    )


def _confident_wrong(answer: Answer, effect: str) -> bool:
    return any(cause.effect != effect and cause.probability >= CONFIDENT for cause in answer.causes)


def _trial(task: tuple[str, bool, int, float]) -> Trial:
    """One campaign, the recommended measurement, and both together."""
    effect, hidden, seed, wanted = task
    shape = (HIDDEN if hidden else SEEN)[effect](np.random.default_rng([seed, zlib.crc32(effect.encode())]))
    left_out = () if hidden else UNLISTED.get(effect, (effect,))
    known = {name: settings for name, settings in LISTED.items() if name not in left_out}
    joint = _joint({name: {} for name in known})
    plan = _paper_plan(_joint(known), seed)
    asked: tuple[str, ...] = ()
    if hidden:
        first = _answer(_measured(plan, _joint(known), seed), joint)
        unseen = replace(first.design, invisible=(effect,), not_testable=())
        chosen = next_measurement(first.problem, unseen).chosen
        size = 0.0
    else:
        size = _size(plan, joint, effect, shape, wanted * NOISE_ARCSEC, 0)
        first = _answer(_measured(plan, _joint({**known, effect: shape(size)}), seed), joint)
        asked = first.asked
        chosen = next_measurement(first.problem, first.design, asked, first.found).chosen if asked else None
    before = asked or (first.causes[0].effect_class if first.causes else ())
    if chosen is None:
        return Trial(effect=effect, hidden=hidden, seed=seed, asked=bool(asked), before=before, said=first.said)
    longer = extended(plan, chosen.name, chosen.times)
    assert longer is not None
    if hidden:
        size = _size(longer, joint, effect, shape, wanted * NOISE_ARCSEC, len(plan))
    whole = _answer(_measured(longer, _joint({**known, effect: shape(size)}), seed), joint)
    return Trial(
        effect=effect,
        hidden=hidden,
        seed=seed,
        asked=True,
        before=before,
        measured=chosen.name if chosen.times == 1 else f"{chosen.times} x {chosen.name}",
        promised=chosen.shows if hidden else chosen.separates,
        after=whole.causes[0].effect_class if whole.causes else (),
        confident_wrong=_confident_wrong(whole, effect),
        said=f"{first.said} -> {whole.said}",
    )


def _share(hits: int, cases: int) -> str:
    if cases == 0:
        return "0 of 0"
    low, high = exact_binomial(hits, cases)
    return f"{hits} of {cases} ({low:.2f}..{high:.2f})"


def _print_totals(trials: Sequence[Trial], *, hidden: bool) -> None:
    asked = [each for each in trials if each.tried and each.hidden == hidden]
    promising = [each for each in asked if each.promising]
    print(f"{'hidden effects' if hidden else 'classes'}: of {sum(t.hidden == hidden for t in trials)} campaigns")
    if not hidden:
        print(f"  asked, the true effect in the class: {len(asked)}")
        print(f"  still in the first cause's class:    {_share(sum(t.kept for t in asked), len(asked))}")
        sizes = [(len(t.before), len(t.after)) for t in asked]
        if sizes:
            before, after = np.mean(sizes, axis=0)
            print(f"  mean class size: {before:.2f} before, {after:.2f} after")
    print(f"  what the text says came true:        {_share(sum(t.come_true for t in promising), len(promising))}")
    wrong = sum(each.confident_wrong for each in asked)
    print(f"  a wrong name at {CONFIDENT} or more:         {_share(wrong, len(asked))}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate, diagnose, measure as recommended, diagnose again, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6, help="campaigns of each effect")
    parser.add_argument("--seed", type=int, default=1, help="of the first")
    parser.add_argument("--enr", type=float, default=2.0, help="effect-to-noise ratio")
    parser.add_argument("--effects", nargs="*", default=[*SEEN, *HIDDEN], help="of the true effect")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args(arguments)
    seeds = range(options.seed, options.seed + options.seeds)
    tasks = [
        (name, hidden, seed, options.enr)
        for hidden, names in ((False, SEEN), (True, HIDDEN))
        for name in names
        if name in options.effects
        for seed in seeds
    ]
    with Pool(options.processes) as pool:
        trials = pool.map(_trial, tasks, chunksize=4)
    print(f"{'true effect':<20} {'measured':<20} {'asked':>5} {'kept':>5} {'true':>9} {'wrong':>5}")
    rows: dict[tuple[str, str], list[Trial]] = {}
    for each in trials:
        name = f"{each.effect}{' (hidden)' if each.hidden else ''}"
        rows.setdefault((name, each.measured or "-"), []).append(each)
    for (name, measured), some in rows.items():
        asked = [each for each in some if each.tried]
        promising = [each for each in asked if each.promising]
        come_true = f"{sum(t.come_true for t in promising)}/{len(promising)}"
        kept, wrong = sum(t.kept for t in asked), sum(t.confident_wrong for t in asked)
        print(f"{name:<26} {measured:<20} {len(some):>3} {len(asked):>5} {kept:>5} {come_true:>9} {wrong:>5}")
    for each in trials:
        if not each.tried or (each.promising and not each.come_true) or not each.kept or each.confident_wrong:
            print(
                f"  {each.effect} {each.seed}{' hidden' if each.hidden else ''}: {'|'.join(each.before)} -"
                f"{each.measured}: {'|'.join(each.promised)}- {'|'.join(each.after)}; {each.said}"
            )
    for hidden in (False, True):
        _print_totals(trials, hidden=hidden)


if __name__ == "__main__":
    main()
