"""From an attribution to words: names with probability and class, unknown, and effects of the scatter."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.training import gap_campaigns

from trueangle_training.diagnosis.attribution import attribute
from trueangle_training.diagnosis.confidence import Grounds, class_probability
from trueangle_training.diagnosis.design_check import design_check
from trueangle_training.diagnosis.diagnose import diagnose, prepare, update_of
from trueangle_training.diagnosis.found_parts import found_parts
from trueangle_training.diagnosis.plain_notes import loud_note
from trueangle_training.diagnosis.problem import Problem, problem_of
from trueangle_training.diagnosis.scatter import coarser_ratio, loud_run, noise_growth
from trueangle_training.diagnosis.verdict import Verdict, VerdictKind, verdict_of
from trueangle_training.effects import EFFECTS
from trueangle_training.effects.cells import Cell

Floats = NDArray[np.float64]


RISING_C = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
"""As the paper's plan goes: the temperature is a clock, so that lag and drift look alike."""


def _problem(seed: int, pattern: gap_campaigns.Pattern | None = None, **plan: Any) -> Problem:
    return gap_campaigns.problem(gap_campaigns.campaign(seed, pattern, **plan), shapes=True)


def _verdict(problem: Problem) -> Verdict:
    return verdict_of(problem, attribute(problem), design_check(problem.without_errors()))


def test_nothing_is_none() -> None:
    verdict = _verdict(_problem(41))
    assert verdict.kind is VerdictKind.NONE
    assert verdict.causes == ()
    assert not verdict.unexplained.significant


def test_an_effect_that_stands_alone_is_named() -> None:
    verdict = _verdict(_problem(42, lambda theta, t, run: 0.03 * (t - 20) * np.cos(4 * theta)))
    assert verdict.kind is VerdictKind.NAMED
    (cause,) = verdict.named
    assert cause.effect == "thermal_graduation"
    assert cause.effect_class == ("thermal_graduation",)
    assert cause.probability >= 0.9
    assert any("amplitude" in name for name in cause.parameters)


def test_a_constant_pattern_is_a_class_and_no_single_name_is_sure() -> None:
    verdict = _verdict(_problem(43, lambda theta, t, run: 0.8 * np.cos(5 * theta)))
    (cause,) = verdict.causes
    assert {"graduation_error", "reference_artefact"} <= set(cause.effect_class)
    assert cause.class_probability >= 0.9
    assert cause.probability < 0.9


def test_the_class_holds_only_what_the_design_check_had_listed() -> None:
    problem = _problem(43, lambda theta, t, run: 0.8 * np.cos(5 * theta))
    design = design_check(problem.without_errors())
    for cause in verdict_of(problem, attribute(problem), design).causes:
        assert set(cause.effect_class[1:]) <= set(design.confusable(cause.effect))


def _wandering(theta: Floats, t: Floats, run: NDArray[np.int64]) -> Floats:
    """A phase that wanders with the temperature at order 4: in no library."""
    return 1.5 * np.cos(4 * theta - 0.02 * (t - 25) ** 2)


def test_what_no_effect_explains_is_unknown_with_its_cells() -> None:
    verdict = _verdict(_problem(44, _wandering))
    assert verdict.kind is VerdictKind.UNKNOWN or verdict.unexplained.significant
    assert verdict.unexplained.significant
    assert "4" in {cell.order for cell in verdict.unexplained.cells}
    assert 0.0 <= verdict.unexplained.nearest_share <= 1.0


def test_a_withheld_effect_is_unknown_and_named_once_it_is_back() -> None:
    made = gap_campaigns.campaign(45, lambda theta, t, run: 0.03 * (t - 20) * np.cos(4 * theta))
    without = {name: effect for name, effect in EFFECTS.items() if name != "thermal_graduation"}
    missing = _verdict(problem_of(made, gap_campaigns.joint(), library=without))
    assert missing.unexplained.significant
    assert "thermal_graduation" not in {cause.effect for cause in missing.named}
    cells = {(cell.order, cell.temperature) for cell in missing.unexplained.cells}
    assert ("4", "linear") in cells
    assert "thermal_graduation" in {
        cause.effect
        for cause in _verdict(_problem(45, lambda theta, t, run: 0.03 * (t - 20) * np.cos(4 * theta))).named
    }


@pytest.mark.parametrize(
    ("order", "withheld", "listed"),
    [
        (2, "thermal_tilt", ("eccentricity", "grating_tilt", "thermal_eccentricity")),
        (1, "thermal_eccentricity", ("eccentricity", "grating_tilt")),
    ],
)
def test_a_drift_that_the_library_lacks_is_not_laid_to_a_lag_or_a_bend(
    order: int, withheld: str, listed: tuple[str, ...]
) -> None:
    made = gap_campaigns.campaign(
        57, lambda theta, t, run: 0.08 * (t - 25) * np.cos(order * theta + 0.4), temperatures_c=RISING_C
    )
    without = {name: effect for name, effect in EFFECTS.items() if name != withheld}
    joint = gap_campaigns.joint({name: {} for name in listed})
    missing = _verdict(problem_of(made, joint, library=without))
    assert missing.kind is VerdictKind.UNKNOWN
    assert missing.named == ()
    assert (str(order), "linear") in {(cell.order, cell.temperature) for cell in missing.unexplained.cells}
    assert withheld in {cause.effect for cause in _verdict(problem_of(made, joint)).named}


def _squared(theta: Floats, t: Floats, run: NDArray[np.int64]) -> Floats:
    """Instead of the campaign's own straight drift."""
    return 0.004 * (t - 20) ** 2 * np.cos(theta - 0.5) - 0.1 * (t - 20) * np.sin(theta)


def _lost(theta: Floats, t: Floats, run: NDArray[np.int64]) -> Floats:
    return 2.5 * ((run == 9) & (theta > 2.0))


def _over_faces(theta: Floats, t: Floats, run: NDArray[np.int64]) -> Floats:
    """Instead of the campaign's own tilt."""
    of_faces = np.random.default_rng(7).normal(0.0, 1.0, 23)
    return of_faces[np.rint(theta * 23 / (2 * np.pi)).astype(int)] - 3.0 * np.cos(2 * theta)


ALL_LISTED = ("eccentricity", "grating_tilt", "thermal_eccentricity")


@pytest.mark.parametrize(
    ("pattern", "withheld", "listed", "place"),
    [
        (
            _squared,
            "thermal_nonlinearity",
            ("eccentricity", "grating_tilt"),
            Cell(order="1", temperature="quadratic"),
        ),
        (_lost, "count_loss", ALL_LISTED, Cell(order="0", time="within_run")),
        (
            _over_faces,
            "reference_artefact",
            ("eccentricity", "thermal_eccentricity"),
            Cell(order="1", frame="polygon"),
        ),
    ],
)
def test_a_withheld_effect_is_not_pieced_together_from_the_names_that_are_left(
    pattern: gap_campaigns.Pattern, withheld: str, listed: tuple[str, ...], place: Cell
) -> None:
    without = {name: effect for name, effect in EFFECTS.items() if name != withheld}
    joint = gap_campaigns.joint({name: {} for name in listed})
    made = gap_campaigns.campaign(61, pattern, temperatures_c=RISING_C)
    missing = _verdict(problem_of(made, joint, library=without))
    assert missing.named == ()
    assert place in missing.unexplained.cells
    assert withheld in {name for cause in _verdict(problem_of(made, joint)).named for name in cause.effect_class}
    nothing = gap_campaigns.campaign(62, temperatures_c=RISING_C)
    assert _verdict(problem_of(nothing, gap_campaigns.joint(), library=without)).kind is VerdictKind.NONE


def test_what_a_bent_shape_leaves_over_is_no_growing_noise() -> None:
    def bent(theta: Floats, t: Floats, run: NDArray[np.int64]) -> Floats:
        # A tenth of the curve is of another order in each run: like noise, and the larger the warmer it is.
        own = np.random.default_rng(3).uniform(0, 2 * np.pi, (2, 1000))[:, run]
        rest = np.cos(7 * theta + own[0]) + np.cos(9 * theta + own[1])
        # In quadrature: in phase, the steady part and the one that grows would be one pattern.
        steady, growing = 10 * np.sin(4 * theta), (t - 20) * np.cos(4 * theta)
        return 0.4 * (steady + growing + 0.06 * (t - 10) * rest)

    problem = _problem(58, bent)
    attribution = attribute(problem)
    assert noise_growth(problem, attribution.noise, np.zeros(len(problem)))[0].significant
    named = {cause.effect for cause in _verdict(problem).named}
    assert "thermal_graduation" in named
    assert "noise_growth" not in named


def _louder(problem: Problem, by_temperature: float) -> Problem:
    """Noise whose standard deviation grows by a factor over the plan's temperatures."""
    t = problem.conditions.temperature_c
    assert t is not None
    rng = np.random.default_rng(9)
    share = (t - t.min()) / np.ptp(t)
    extra = np.sqrt(by_temperature ** (2 * share) - 1.0) * gap_campaigns.SIGMA_ARCSEC
    return replace(problem, error_arcsec=problem.error_arcsec + extra * rng.normal(size=len(problem)))


def test_noise_that_grows_with_temperature_is_found_and_steady_noise_is_not() -> None:
    loud = _louder(_problem(46), 3.0)
    (found, *_) = noise_growth(loud, attribute(loud).noise, np.zeros(len(loud)))
    assert found.condition == "temperature_c"
    assert found.significant
    # 21 runs of some 14 degrees of freedom know the ratio to a fifth.
    assert found.ratio == pytest.approx(3.0, rel=0.4)
    assert _verdict(loud).named[0].effect == "noise_growth"
    steady = [noise_growth(p, attribute(p).noise, np.zeros(len(p))) for p in (_problem(50 + i) for i in range(6))]
    assert not any(each and each[0].significant for each in steady)


def test_scatter_that_the_library_has_no_name_for_is_unknown_in_its_cell() -> None:
    """An effect that is withheld must not pass for none."""
    loud = _louder(_problem(46), 3.0)
    nameless = _verdict(replace(loud, library={k: v for k, v in EFFECTS.items() if k != "noise_growth"}))
    assert nameless.kind is VerdictKind.UNKNOWN
    assert nameless.causes == ()
    assert nameless.unexplained.cells == (Cell(order="0", temperature="linear", moment="variance"),)
    problem = _problem(47)
    counts = problem.conditions.counts_per_rev
    coarse = np.rint(problem.conditions.angle_deg * counts / 360 / 8) * 8 * 360 / counts
    rounded = replace(problem, conditions=replace(problem.conditions, angle_deg=coarse))
    assert "quantisation" in {cause.effect for cause in _verdict(rounded).named}
    library = {k: v for k, v in EFFECTS.items() if k != "quantisation"}
    withheld = _verdict(replace(rounded, library=library))
    assert withheld.kind is VerdictKind.UNKNOWN
    assert Cell(order="0", moment="variance") in withheld.unexplained.cells


def test_one_run_that_scatters_beyond_all_others_is_unknown() -> None:
    problem = _problem(59)
    odd = problem.conditions.run == 9
    disturbed = np.where(
        odd, np.random.default_rng(4).normal(scale=6.0 * gap_campaigns.SIGMA_ARCSEC, size=483), 0.0
    )
    wild = replace(problem, error_arcsec=problem.error_arcsec + disturbed)
    assert loud_run(wild, attribute(wild).noise) == 9
    assert "run 9 " in loud_note(wild, attribute(wild).noise)[0]
    assert loud_run(problem, attribute(problem).noise) is None
    verdict = _verdict(wild)
    assert verdict.kind is VerdictKind.UNKNOWN
    assert verdict.unexplained.significant


def test_a_coarser_lattice_of_counts_is_found_wherever_its_zero_is() -> None:
    problem = _problem(47)
    counts = problem.conditions.counts_per_rev
    whole = np.rint(problem.conditions.angle_deg * counts / 360)
    exact = replace(problem.conditions, angle_deg=whole * 360 / counts)
    assert coarser_ratio(exact) is None
    for ratio, zero in ((2, 0), (7, 3)):
        coarse = (np.rint((whole - zero) / ratio) * ratio + zero) * 360 / counts
        assert coarser_ratio(replace(exact, angle_deg=coarse)) == ratio


def test_angles_that_are_no_whole_counts_show_no_lattice() -> None:
    problem = _problem(48)
    blurred = problem.conditions.angle_deg + np.random.default_rng(1).uniform(0, 1e-4, len(problem))
    assert coarser_ratio(replace(problem.conditions, angle_deg=blurred)) is None


def test_the_probability_rises_with_the_margin_and_falls_with_what_the_rule_leaves() -> None:
    base = Grounds(margin=3.0, left=0.02, by_named_share=False)
    middle = class_probability(base)
    assert class_probability(replace(base, margin=7.0)) > middle
    assert class_probability(replace(base, margin=-6.0)) < 0.5
    by_rule = [class_probability(replace(base, left=left, by_named_share=True)) for left in (0.0, 0.03, 0.09)]
    assert middle == by_rule[0] > by_rule[1] > by_rule[2]
    for sure in (-1e9, 1e9):
        assert 0.0 <= class_probability(replace(base, margin=sure)) < 1.0


def test_the_parameters_of_hysteresis_are_those_that_the_updated_joint_has() -> None:
    """Its bend with the angle is fitted beside order 0 and goes into JOINT.yaml: the report lists it."""

    def both_ways(theta: np.ndarray, t: np.ndarray, run: np.ndarray) -> np.ndarray:
        return np.where(run % 2 == 1, 1.0, -1.0) * (2.0 + 0.6 * np.cos(theta - 0.5))

    made = gap_campaigns.campaign(5, both_ways, directions=(1, -1))
    made = replace(made, zero_group=(made.run + 1) // 2)
    diagnosis = diagnose(prepare(made, gap_campaigns.joint()))
    update = update_of(diagnosis)
    assert update is not None
    cause = next(each for each in diagnosis.findings.causes if each.effect == "hysteresis")
    written = update.effects["hysteresis"]["harmonics"]
    assert {each["order"] for each in written} == {0, 1, 2}
    for each in written[1:]:
        listed = cause.parameters[f"order_{each['order']}_amplitude_arcsec"]
        assert listed.standard_uncertainty is not None
        assert listed.value == pytest.approx(each["amplitude_arcsec"], abs=1e-3)


@pytest.mark.parametrize(
    ("temperatures_c", "clock"), [(RISING_C, True), ((*RISING_C[::2], *RISING_C[::-2]), False)]
)
def test_where_no_temperature_comes_again_a_bend_in_temperature_may_lie_between_the_runs(
    temperatures_c: tuple[float, ...], clock: bool
) -> None:
    problem = _problem(
        51, lambda theta, t, run: 1.2 * np.sin(t / 3.0) * np.cos(6 * theta), temperatures_c=temperatures_c
    )
    attribution = attribute(problem)
    (part,) = found_parts(problem, attribution, design_check(problem.without_errors()).spans)
    assert part.cell.order == "6"
    assert part.cell.temperature != "constant"
    between = Cell(order="6", time="between_runs")
    assert (part.elsewhere is not None and part.elsewhere.cell == between) == clock


def test_a_constant_order_on_a_polygon_may_be_another_pattern_over_the_faces() -> None:
    problem = _problem(52, lambda theta, t, run: 0.8 * np.cos(5 * theta))
    attribution = attribute(problem)
    (part,) = found_parts(problem, attribution, design_check(problem.without_errors()).spans)
    assert part.cell == Cell(order="5")
    assert part.elsewhere is not None
    assert part.elsewhere.carried > 0.95
    elsewhere = part.elsewhere.cell
    assert (elsewhere.temperature, elsewhere.time) == ("constant", "constant")
    by_face = elsewhere.frame == "polygon" and elsewhere.order == "5"
    assert by_face or elsewhere.order in ("N", "2N", "4N", "non-integer", "localized")


def test_with_one_direction_and_one_load_a_constant_order_is_the_gratings_first() -> None:
    """What follows direction or load as well would be seen by its bend over the angle only."""
    made = gap_campaigns.campaign(53, lambda theta, t, run: 1.5 * np.cos(2 * theta))
    listed = gap_campaigns.joint({"eccentricity": {}, "thermal_eccentricity": {}})
    cause = _verdict(gap_campaigns.problem(made, listed, shapes=True)).causes[0]
    assert cause.effect == "grating_tilt"
    assert {"hysteresis", "load_deflection"} <= set(cause.effect_class)
    assert cause.probability > 1.5 / len(cause.effect_class)


def test_a_pattern_over_all_faces_may_be_a_sum_and_draws_of_the_runs_are_none() -> None:
    faces = np.random.default_rng(54).normal(0.0, 1.5, gap_campaigns.FACES)
    place = 2 * np.pi / gap_campaigns.FACES
    wide = _verdict(_problem(54, lambda theta, t, run: faces[np.rint(theta / place).astype(int)])).causes[0]
    assert wide.effect in ("reference_artefact", "graduation_error")
    assert wide.class_probability >= 0.9
    assert wide.probability <= 0.5
    phase = np.random.default_rng(55).uniform(0.0, 2 * np.pi, 64)
    drawn = _verdict(_problem(55, lambda theta, t, run: 1.5 * np.cos(theta - phase[run]))).causes[0]
    assert drawn.effect == "run_to_run_eccentricity"
    assert drawn.probability >= 0.9
