"""FE-BPNN: the paper's Fourier series and network from random initial weights, without the genetic algorithm."""

from trueangle_training.genetic import GeneticOptions
from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnOptions, FeGabpnnPaper, Fitness


def make(base_temperature_c: float) -> FeGabpnnPaper:
    """Section 4.3.3: one random start, 20 hidden nodes."""
    options = FeGabpnnOptions(
        base_temperature_c=base_temperature_c,
        genetic=GeneticOptions(individuals=1, generations=0),
        fitness=Fitness.UNTRAINED,
    )
    return FeGabpnnPaper(
        options=options, name="fe-bpnn", summary="the paper's network without the genetic algorithm"
    )
