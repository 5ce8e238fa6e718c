"""The hidden-node sweep: what is left out, what is counted, and when there is nothing to sweep."""

from dataclasses import replace

import numpy as np
import pytest
from tests.training.reference_joint import polygon_campaign

from trueangle_training.evaluation.held_out import HeldOutKind, hold_out, subset, temperature_folds
from trueangle_training.hidden_node_sweep import (
    COEFFICIENT_NODES,
    GENERATIONS,
    INDIVIDUALS,
    PAPER_NODES,
    hidden_node_sweep,
)
from trueangle_training.methods import TrainingReadings
from trueangle_training.methods.fe_gabpnn import FeGabpnn, FeGabpnnSettings
from trueangle_training.methods.registry import load_method


@pytest.fixture(scope="module")
def readings() -> TrainingReadings:
    made = polygon_campaign(5)
    return TrainingReadings(
        angle_deg=made.angle_deg, error_arcsec=made.error_arcsec, temperature_c=made.temperature_c, run=made.run
    )


def test_points_are_the_left_out_errors_of_networks_of_one_size(readings: TrainingReadings) -> None:
    told: list[tuple[int, int]] = []
    sweep = hidden_node_sweep(
        readings, FeGabpnn(), seed=3, progress=lambda done, total: told.append((done, total))
    )
    assert sweep is not None
    assert tuple(point.hidden_nodes for point in sweep.points) == COEFFICIENT_NODES
    folds = temperature_folds(readings)
    settings = FeGabpnnSettings(hidden_nodes=(2,), individuals=INDIVIDUALS, generations=GENERATIONS)
    alone = hold_out(readings, FeGabpnn(settings=settings), HeldOutKind.TEMPERATURE, folds, seed=3)
    point = sweep.points[1]
    assert point.rmse_arcsec == pytest.approx(alone.rmse_arcsec, rel=1e-12)
    # Pooled from the temperatures' own RMSE, whose freedoms are equal here.
    assert point.rmse_arcsec == pytest.approx(np.sqrt(np.mean(np.square(point.at_temperature_arcsec))), rel=1e-9)
    # sd(MSE) / sqrt(K) for the mean square, and half of that over the RMSE for its root.
    squares = np.square(point.at_temperature_arcsec)
    expected = np.std(squares, ddof=1) / np.sqrt(squares.size) / (2.0 * point.rmse_arcsec)
    assert point.standard_error_arcsec == pytest.approx(expected, rel=1e-9)
    assert len(point.at_temperature_arcsec) == len(sweep.temperatures) == len(folds)
    total = len(COEFFICIENT_NODES) * len(folds)
    assert told == [(done + 1, total) for done in range(total)]


def test_the_base_temperature_that_the_paper_needs_is_left_out_of_all_points(readings: TrainingReadings) -> None:
    sweep = hidden_node_sweep(readings, load_method("fe-bpnn"))
    assert sweep is not None
    assert tuple(point.hidden_nodes for point in sweep.points) == PAPER_NODES
    assert len(sweep.temperatures) == len(temperature_folds(readings)) - 1
    assert not any(label.startswith(("19.", "20.")) for label in sweep.temperatures)
    assert "the model itself has 20" in sweep.setting


def test_sizes_with_more_parameters_than_readings_are_not_trained(readings: TrainingReadings) -> None:
    # One run a temperature: 161 readings less 23, of which a tenth is kept for validation.
    few = subset(readings, readings.run % 3 == 1)
    sweep = hidden_node_sweep(few, load_method("bpnn"))
    # 138 readings, 124 of them to train on; 121 parameters of 30 nodes are still fewer.
    assert sweep is not None
    assert [point.hidden_nodes for point in sweep.points] == [5, 10, 15, 20, 25, 30]
    fewer = subset(few, few.temperature_c < 27.0)
    sweep = hidden_node_sweep(fewer, load_method("bpnn"))
    # 69 readings, 62 of them to train on: 61 parameters of 15 nodes, 81 of 20.
    assert sweep is not None
    assert [point.hidden_nodes for point in sweep.points] == [5, 10, 15]
    fewest = subset(few, few.temperature_c < 22.0)
    # 46 readings, 41 to train on: 41 parameters of 10 nodes are too many, and one size alone is no sweep.
    assert hidden_node_sweep(fewest, load_method("bpnn")) is None


@pytest.mark.parametrize("name", ["linear", "poly2d"])
def test_methods_without_hidden_nodes_have_no_sweep(readings: TrainingReadings, name: str) -> None:
    assert hidden_node_sweep(readings, load_method(name)) is None


def test_two_temperatures_have_no_sweep(readings: TrainingReadings) -> None:
    two = subset(readings, readings.temperature_c < 17.0)
    assert hidden_node_sweep(two, FeGabpnn()) is None


def test_the_same_seed_gives_the_same_sweep_and_a_method_that_asks_for_less_gets_less(
    readings: TrainingReadings,
) -> None:
    quick = FeGabpnn(settings=replace(FeGabpnnSettings(), individuals=4, generations=0))
    sweep = hidden_node_sweep(readings, quick)
    assert sweep is not None
    assert sweep == hidden_node_sweep(readings, quick)
    assert "4 individuals in 0 generations" in sweep.setting
