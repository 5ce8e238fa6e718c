"""The map of cells: as many false alarms as allowed on coloured noise, and planted patterns where they are."""

import numpy as np
import pytest
from tests.training.gap_campaigns import SIGMA_ARCSEC, campaign, problem

from trueangle.contract.calibration import read_campaign
from trueangle.contract.document import document_from_plain
from trueangle.contract.joint import joint_from_document
from trueangle_training.diagnosis.location import CellFit, Elsewhere, FoundPart, where
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import recalibration_span
from trueangle_training.diagnosis.scatter_map import run_homogeneity
from trueangle_training.diagnosis.sign_flips import flip_test, visible_block
from trueangle_training.diagnosis.wander import FLICKER_SHARE, excess
from trueangle_training.effects.cells import Cell


def places(made: Problem, *found: FoundPart):
    return where(made, floor_arcsec2=SIGMA_ARCSEC**2, rng=np.random.default_rng(1), found=found)


def test_noise_is_significant_in_no_more_than_one_map_of_twenty() -> None:
    """Mean and scatter cells are a family of 5 % each: 20 maps have 7 or more with probability below 0.005."""
    alarms = sum(any(p.significant for p in places(problem(campaign(seed)))) for seed in range(200, 220))
    assert alarms < 7


@pytest.mark.parametrize(
    ("pattern", "cell"),
    [
        (lambda theta, t, run: 0.5 * np.cos(5 * theta), Cell(order="5")),
        (lambda theta, t, run: 0.05 * (t - 25) * np.cos(3 * theta), Cell(order="3", temperature="linear")),
        (
            lambda theta, t, run: 0.004 * (t - 25) ** 2 * np.cos(2 * theta),
            Cell(order="2", temperature="quadratic"),
        ),
        (lambda theta, t, run: 0.5 * theta, Cell(order="0", time="within_run")),
    ],
    ids=["order 5", "order 3 with temperature", "order 2 bent over temperature", "creep in a run"],
)
def test_a_planted_pattern_is_significant_and_first(pattern: object, cell: Cell) -> None:
    found = places(problem(campaign(20, pattern)))  # pyright: ignore[reportArgumentType]
    assert found[0].significant
    if cell.time == "constant":
        assert found[0].cell == cell
        assert found[0].share > 0.7
    else:
        # On an equally spaced polygon a slope within the run is a pattern over the faces as well.
        assert cell in {each.cell for each in found if each.significant}


def test_a_pattern_with_the_direction_is_odd() -> None:
    made = campaign(
        21, lambda theta, t, run: np.where(run % 2 == 0, 0.4, -0.4) * np.cos(2 * theta), directions=(1, -1)
    )
    assert places(problem(made))[0].cell == Cell(order="2", direction="odd")


def test_what_was_found_leads_the_map() -> None:
    made = problem(campaign(22, lambda theta, t, run: 0.5 * np.cos(5 * theta)))
    curve = 0.5 * np.cos(5 * np.radians(made.conditions.angle_deg))
    cell = Cell(order="5")
    found = places(made, FoundPart(cell=cell, fit=CellFit.WHOLE, curve_arcsec=curve))
    assert found[0].cell == cell
    assert sum(each.share for each in found) == pytest.approx(1.0)
    assert found[0].share > 0.95


def test_another_likely_cell_comes_second_and_takes_no_share() -> None:
    made = problem(campaign(22, lambda theta, t, run: 0.5 * np.cos(5 * theta)))
    curve = 0.5 * np.cos(5 * np.radians(made.conditions.angle_deg))
    polygon, cell = Cell(order="0", frame="polygon"), Cell(order="5")
    other = Elsewhere(cell=polygon, carried=0.97)
    found = places(made, FoundPart(cell=cell, fit=CellFit.WHOLE, curve_arcsec=curve, elsewhere=other))
    assert [each.cell for each in found[:2]] == [cell, polygon]
    assert found[1].could_carry == pytest.approx(0.97)
    assert found[1].share < 0.05


def test_a_shape_that_no_cell_says_in_full_is_followed_by_the_nearest_cell() -> None:
    """A saturating creep: its own cell first, then the straight line in time that comes nearest."""
    made = problem(campaign(22, directions=(1, -1)))
    run = made.conditions.run
    place = np.concatenate([np.linspace(0.0, 1.0, int(np.sum(run == each))) for each in np.unique(run)])
    curve = np.where(made.conditions.direction == 1, 1.0, -1.0) * (1.0 - np.exp(-3.0 * place))
    own = Cell(order="0", direction="odd", time="within_run")
    found = places(made, FoundPart(cell=own, fit=CellFit.WHOLE, curve_arcsec=curve))
    assert found[0].cell == own
    assert found[0].could_carry < found[1].could_carry <= 1.0
    assert found[1].share == 0.0


def test_cells_of_few_runs_are_not_testable_and_say_how_many_are_needed() -> None:
    made = problem(campaign(23, temperatures_c=(10.0, 20.0, 30.0), repeats=2))
    found = places(made)
    assert found
    mean = [each for each in found if each.cell.moment == "mean"]
    assert not any(each.significant for each in mean)
    assert {each.runs_needed for each in mean if each.p_value is None} == {8}


def test_flipping_runs_reaches_the_smallest_p_of_an_exact_pattern() -> None:
    """All 10 runs agree: only the flips that leave all signs alike are as extreme, p about 2^-9."""
    made = problem(campaign(24, temperatures_c=(20.0,), repeats=10))
    span = recalibration_span(made)
    theta = np.radians(made.conditions.angle_deg)
    block = visible_block(np.cos(5 * theta)[:, None], span, least_visible=0.02)
    assert block is not None
    unit = made.conditions.run - 1
    test = flip_test(
        span.outside(np.cos(5 * theta)), [block], unit, span, flips=8000, rng=np.random.default_rng(2)
    )
    assert test.own_p_value[0] == pytest.approx(2.0**-9, rel=0.6)


def test_scatter_that_grows_with_temperature_is_on_the_map_of_the_variance() -> None:
    rng = np.random.default_rng(3)
    made = campaign(25, lambda theta, t, run: rng.normal(0.0, 0.06 * (t - 5.0)))
    found = [each for each in places(problem(made)) if each.cell.moment == "variance" and each.significant]
    assert Cell(order="0", temperature="linear", moment="variance") in {each.cell for each in found}


def test_one_odd_run_and_a_step_between_runs_are_found_and_alike_runs_are_not() -> None:
    def homogeneity(seed: int, pattern: object = None):
        made = problem(campaign(seed, pattern))  # pyright: ignore[reportArgumentType]
        result = run_homogeneity(
            made, recalibration_span(made).outside(made.error_arcsec), np.random.default_rng(4)
        )
        assert result is not None
        return result

    odd = homogeneity(30, lambda theta, t, run: 2.0 * (run == 7) * np.cos(4 * theta))
    assert (odd.odd_run, odd.odd_p_value < 0.001) == (7, True)
    step = homogeneity(31, lambda theta, t, run: 0.8 * (run >= 12) * np.cos(3 * theta))
    assert (step.first_run_after_step, step.step_p_value < 0.01) == (12, True)
    alike = [homogeneity(seed) for seed in range(300, 340)]
    # 40 campaigns at 5 %: seven or more alarms have probability 0.003.
    assert sum(each.odd_p_value < 0.05 for each in alike) < 7
    assert sum(each.step_p_value < 0.05 for each in alike) < 7


ENCODER = {"schema_version": 1, "encoder": {"lines_per_rev": 16384, "counts_per_rev": 3_276_800}}


def wandering(seed: int, *, wander_arcsec: float = 0.5, slope: float = 0.0) -> Problem:
    """16 sweeps, four at each of four temperatures, and two slow ramps, all under one zero that wanders.

    The wander is a random walk with a leash of six hours: neighbouring runs have nearly the same.
    """
    rng = np.random.default_rng(seed)
    parts: list[tuple[np.ndarray, ...]] = []
    clock_s, run = 0.0, 0
    for set_c in (10.0, 20.0, 30.0, 40.0):
        clock_s += 3 * 3600.0
        for _ in range(4):
            run += 1
            step = np.arange(60)
            parts.append((step * 12.0, np.full(60, set_c), clock_s + step, np.full(60, run)))
            clock_s += 300.0
    for start_c, stop_c in ((15.0, 35.0), (35.0, 15.0)):
        run += 1
        step = np.arange(240)
        temperature = start_c + (stop_c - start_c) * step / 239.0
        parts.append((step * 27.0, temperature, clock_s + 23.0 * step, np.full(240, run)))
        clock_s += 240 * 23.0 + 600.0
    angle, temperature, time, runs = (np.concatenate(part) for part in zip(*parts, strict=True))
    kept = np.exp(-np.diff(time, prepend=time[0]) / (6 * 3600.0))
    walk, state = np.empty(time.size), float(rng.normal())
    for i, part in enumerate(kept.tolist()):
        state = part * state + np.sqrt(1.0 - part**2) * float(rng.normal())
        walk[i] = state
    theta = np.radians(angle)
    error = 20.0 * np.cos(theta) + wander_arcsec * walk + SIGMA_ARCSEC * rng.normal(size=time.size)
    error = error + slope * (temperature - 25.0) * np.cos(3 * theta)
    lines = ["angle_deg,error_arcsec,temperature_c,time_s,run,zero_group"]
    lines += [
        f"{a:.9f},{e:.9f},{t:.4f},{s:.3f},{r},1"
        for a, e, t, s, r in zip(angle, error, temperature, time, runs, strict=True)
    ]
    plain = {
        **ENCODER,
        "reference": {"kind": "encoder"},
        "effects": {"eccentricity": {}, "thermal_eccentricity": {}},
    }
    made_joint = joint_from_document(document_from_plain(plain, source="joint.yaml", path=""))
    return problem(read_campaign("\n".join(lines).encode(), source="measured.csv"), made_joint)


def test_a_zero_that_wanders_is_no_structure() -> None:
    """Cells of order 0 under one zero add up what neighbouring runs have in common; 20 maps at 5 % have 5 or more
    alarms with probability 0.003."""
    alarms = [{p.cell for p in places(wandering(seed)) if p.significant} for seed in range(20)]
    assert sum(bool(cells) for cells in alarms) < 5


def test_beside_a_zero_that_wanders_a_pattern_of_the_angle_is_significant() -> None:
    found = places(wandering(50, slope=0.02))
    assert Cell(order="3", temperature="linear") in {each.cell for each in found if each.significant}


def test_the_excess_of_two_units_that_noise_makes_alike_is_that_of_their_sum() -> None:
    """Two units of one reading a second apart share all that is slow: (1 - f) 2 + f (2 + 2 c) over 2, c the mean
    of exp(-1 / 10^k) over k = 1 alone. A column of opposite signs loses as much."""
    correlation = np.mean([np.exp(-0.1), np.exp(-0.01)])
    columns = np.array([[1.0, 1.0], [1.0, -1.0]])
    found = excess(columns, np.array([0, 1]), np.array([5.0, 6.0]))
    shared = FLICKER_SHARE * correlation
    assert found == pytest.approx([1.0 + shared, 1.0 - shared])


def test_without_a_clock_the_order_of_the_readings_is_one() -> None:
    columns = np.ones((40, 1))
    unit = np.repeat(np.arange(10), 4)
    assert excess(columns, unit, None)[0] > 1.5
    assert excess(columns, np.zeros(40, dtype=np.int64), None)[0] == pytest.approx(1.0)
