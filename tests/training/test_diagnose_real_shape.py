"""Campaigns in the shape of real encoders: nothing planted is nothing found, a planted effect is named."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from tests.benchmarks import real_shape, real_shape_campaigns
from tests.benchmarks.real_shape import NULLS, TABLES, UNIT, Mark, Wish, ask
from tests.benchmarks.real_shape_campaigns import Table, read_tables

from trueangle_training.diagnosis.problem import problem_of

needs_tables = pytest.mark.skipif(
    not (TABLES / f"{UNIT[0]}.csv").is_file(), reason="the tables of real encoders are not beside the repository"
)


@pytest.fixture(scope="module")
def tables() -> Mapping[str, Table]:
    return read_tables(TABLES)


def marked(tables: Mapping[str, Table], stratum: str, ratio: float, *, every_order: bool) -> Mark:
    return ask(Wish(stratum=stratum, ratio=ratio, table=UNIT[0], every_order=every_order, seed=3), tables)


@needs_tables
@pytest.mark.parametrize("stratum", [NULLS[0], NULLS[2]])
def test_a_real_curve_that_the_joint_models_is_no_effect(stratum: str, tables: Mapping[str, Table]) -> None:
    mark = marked(tables, stratum, 0.0, every_order=stratum == NULLS[0])
    assert (mark.verdict, mark.causes) == ("none", ())
    # Noise of a fiftieth of the curve's RMS, about a tenth of the RMS between the two calibrations: 1 - 1/10 ** 2.
    assert mark.parametric_share is not None
    assert mark.parametric_share > 0.98


@needs_tables
def test_an_effect_on_top_of_a_real_curve_is_named(tables: Mapping[str, Table]) -> None:
    mark = marked(tables, "hysteresis", 1.0, every_order=True)
    assert mark.ratio == pytest.approx(1.0, rel=1e-6)
    assert mark.outcome == "right"
    assert mark.causes[0][0] == "hysteresis"


@needs_tables
def test_a_real_drift_between_runs_is_unknown_and_not_an_effect(tables: Mapping[str, Table]) -> None:
    mark = marked(tables, "drift_stepping", 2.0, every_order=False)
    assert (mark.outcome, mark.verdict) == ("right", "unknown")
    assert "time between_runs" in mark.cells[0]


def test_at_set_points_of_the_encoder_no_column_follows_the_noise_of_the_reference() -> None:
    where = real_shape_campaigns.layout(both_ways=False)
    noise = real_shape_campaigns.noise(where, 64.0, np.random.default_rng(1))
    measured = real_shape_campaigns.campaign(where, noise)
    problem = problem_of(measured, real_shape_campaigns.joint(real_shape_campaigns.MAKER_ORDER))
    again = problem.conditions.run[1:] != problem.conditions.run[:-1]
    first = np.concatenate([[0], np.flatnonzero(again) + 1])
    # The first stop of each run is the same angle: a curve of the angle has one value there.
    for column in problem.modelled.T:
        assert np.ptp(column[first]) == 0.0


def test_the_noise_has_the_size_asked_for_within_the_runs() -> None:
    where = real_shape_campaigns.layout(both_ways=False)
    noise = real_shape_campaigns.noise(where, 3.0, np.random.default_rng(1))
    scatter = [noise[where.run == run].std() for run in np.unique(where.run)]
    assert np.sqrt(np.mean(np.square(scatter))) == pytest.approx(3.0)


def test_a_folder_without_the_tables_is_said_to_be_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert real_shape.main(["--tables", str(tmp_path)]) == 2
    assert "expected table05.csv and table06.csv, found none" in capsys.readouterr().err
