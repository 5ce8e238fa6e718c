"""BPNN: the paper's plain network of angle and temperature, without Fourier series or genetic algorithm."""

from trueangle_training.genetic import GeneticOptions
from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnOptions, FeGabpnnPaper, Fitness

HIDDEN_NODES = 25


def make(base_temperature_c: float) -> FeGabpnnPaper:
    """Section 4.3.3: one random start, 25 hidden nodes."""
    options = FeGabpnnOptions(
        base_temperature_c=base_temperature_c,
        fourier_base=False,
        hidden_nodes=HIDDEN_NODES,
        genetic=GeneticOptions(individuals=1, generations=0),
        fitness=Fitness.UNTRAINED,
    )
    return FeGabpnnPaper(options=options, name="bpnn", summary="the paper's plain network, 25 nodes")
