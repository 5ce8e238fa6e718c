"""How many hidden nodes the user's own readings support: Fig. 8 of Jia et al. 2020, but held out.

The paper draws the RMSE of the readings that were trained on, which falls with every node. Here each temperature
in turn is left out, and networks of one size after the other are trained on the rest and judged there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TextIO, cast

import numpy as np
from numpy.typing import NDArray

from trueangle_training.evaluation.held_out import Fold, HeldOut, HeldOutKind, hold_out, temperature_folds
from trueangle_training.methods import Method, Progress, TrainingReadings, no_progress
from trueangle_training.methods.fe_gabpnn import FeGabpnn, FeGabpnnSettings
from trueangle_training.methods.registry import METHODS
from trueangle_training.methods.stages import Stages
from trueangle_training.progress import progress_bar

Floats = NDArray[np.float64]

COEFFICIENT_NODES = (1, 2, 3, 4, 5)
"""Nodes of one input, temperature; the work doubles with every further node."""
INDIVIDUALS, GENERATIONS = 20, 10
"""A third of the default's genetic algorithm: on the example's 483 readings no held-out RMSE changes by 1 %."""
PAPER_NODES = (5, 10, 15, 20, 25, 30)
"""Nodes of two inputs, angle and temperature; the paper takes 20."""
FEWEST_POINTS = 2
FEWEST_FOLDS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPoint:
    """One number of hidden nodes and what it gave at left-out temperatures, in arcsec."""

    hidden_nodes: int
    rmse_arcsec: float
    """Over all left-out readings, runs centred, noise of the readings included."""
    standard_error_arcsec: float
    """Over the left-out temperatures."""
    at_temperature_arcsec: tuple[float, ...]
    """The same RMSE at each of them: differences between points are to be judged pair by pair."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HiddenNodeSweep:
    """All numbers of hidden nodes that were tried with one method."""

    method: str
    setting: str
    """What was trained, in plain words."""
    temperatures: tuple[str, ...]
    """Those left out, with their unit."""
    points: tuple[SweepPoint, ...]
    """At least two, rising."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sizes:
    """A method with one number of hidden nodes after the other."""

    setting: str
    methods: Mapping[int, Method]


def has_hidden_nodes(name: str) -> bool:
    """Whether the method of that name is a network whose size can be swept."""
    return name == "fe-gabpnn" or (name in METHODS and METHODS[name].paper_network)


def hidden_node_sweep(
    readings: TrainingReadings, method: Method, *, seed: int = 0, progress: Progress = no_progress
) -> HiddenNodeSweep | None:
    """Train once a size and a temperature; `progress` is told (trainings done, all trainings).

    None where there is nothing to sweep: no network, too few temperatures to leave one out, or too few readings
    for two sizes.
    """
    folds = temperature_folds(readings)
    sizes = _sizes(method, readings, folds)
    if not folds or sizes is None:
        return None
    done, total = 0, len(sizes.methods) * len(folds)

    def step() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    held_out = {
        nodes: hold_out(readings, each, HeldOutKind.TEMPERATURE, folds, seed=seed, progress=step)
        for nodes, each in sizes.methods.items()
    }
    # What a size is refused, such as the paper's base temperature, is left out of all, so that like meets like.
    common = [fold for fold in folds if all(each.known[fold.left_out].any() for each in held_out.values())]
    if len(common) < FEWEST_FOLDS:
        return None
    return HiddenNodeSweep(
        method=method.name,
        setting=sizes.setting,
        temperatures=tuple(fold.label for fold in common),
        points=tuple(_point(nodes, each, common) for nodes, each in sorted(held_out.items())),
    )


def announced_sweep(
    err: TextIO, readings: TrainingReadings, method: Method, *, seed: int = 0
) -> HiddenNodeSweep | None:
    """The same with a bar on `err`; silent where the method has no hidden nodes."""
    if not has_hidden_nodes(method.name):
        return None
    with progress_bar(err, f"{method.name} with other numbers of hidden nodes, left-out temperatures") as progress:
        return hidden_node_sweep(readings, method, seed=seed, progress=progress)


def _sizes(method: Method, readings: TrainingReadings, folds: tuple[Fold, ...]) -> _Sizes | None:
    if not has_hidden_nodes(method.name) or not folds:
        return None
    if isinstance(method, FeGabpnn):
        return _coefficient_networks(method)
    return _paper_networks(method, len(readings) - max(int(np.count_nonzero(fold.left_out)) for fold in folds))


def _coefficient_networks(method: FeGabpnn) -> _Sizes:
    individuals = min(INDIVIDUALS, method.settings.individuals)
    generations = min(GENERATIONS, method.settings.generations)
    averaged = " and ".join(
        ", ".join(str(nodes) for nodes in method.settings.hidden_nodes).rsplit(", ", maxsplit=1)
    )
    # All sizes begin with the same reduction of the readings.
    shared = method if method.stages is not None else method.sharing(Stages())
    return _Sizes(
        setting=f"networks of one size alone, started by {individuals} individuals in {generations} generations; "
        f"the model itself averages networks of {averaged} hidden nodes by their evidence",
        methods={
            nodes: replace(
                shared,
                settings=FeGabpnnSettings(hidden_nodes=(nodes,), individuals=individuals, generations=generations),
            )
            for nodes in COEFFICIENT_NODES
        },
    )


def _paper_networks(method: Method, fewest_readings: int) -> _Sizes | None:
    """Sizes with fewer parameters than the smallest training part has readings."""
    # torch takes seconds to import, and only these methods need it.
    from trueangle_training.dataset import readings_needed
    from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnPaper, Fitness
    from trueangle_training.network import parameter_count

    paper = cast("FeGabpnnPaper", method)
    options = paper.options
    methods: dict[int, Method] = {
        nodes: replace(paper, options=replace(options, hidden_nodes=nodes, fitness=Fitness.UNTRAINED))
        for nodes in PAPER_NODES
        if readings_needed(parameter_count(nodes), options.validation_fraction) <= fewest_readings
    }
    if len(methods) < FEWEST_POINTS:
        return None
    start = "its genetic algorithm rates untrained weights" if options.genetic.generations else "random starts"
    return _Sizes(
        setting=f"one training a point, {start}; the model itself has {options.hidden_nodes}", methods=methods
    )


def _point(nodes: int, held_out: HeldOut, folds: list[Fold]) -> SweepPoint:
    """RMSE² = sum of squares over sum of freedoms; its standard error is that of a ratio over the folds."""
    squares: Floats = np.array([np.nansum(held_out.residual_arcsec[fold.left_out] ** 2) for fold in folds])
    freedom: Floats = np.array([held_out.degrees_of_freedom[fold.left_out].sum() for fold in folds])
    mean_square = float(squares.sum() / freedom.sum())
    departure = squares - mean_square * freedom
    count = len(folds)
    error_of_square = float(np.sqrt(count / (count - 1) * np.sum(departure**2)) / freedom.sum())
    rmse = float(np.sqrt(mean_square))
    return SweepPoint(
        hidden_nodes=nodes,
        rmse_arcsec=rmse,
        standard_error_arcsec=error_of_square / (2.0 * rmse) if rmse else 0.0,
        at_temperature_arcsec=tuple(np.sqrt(squares / freedom).tolist()),
    )


def sweep_json(sweep: HiddenNodeSweep) -> dict[str, object]:
    """Plain values, as compare.json has them."""
    return {
        "setting": sweep.setting,
        "temperatures": list(sweep.temperatures),
        "points": [
            {
                "hidden_nodes": point.hidden_nodes,
                "rmse": point.rmse_arcsec,
                "standard_error": point.standard_error_arcsec,
                "at_temperature": list(point.at_temperature_arcsec),
            }
            for point in sweep.points
        ],
    }
