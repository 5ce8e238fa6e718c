"""The options of the paper's networks on the command line: what the help states is what is trained."""

import argparse
import re
from typing import cast

import numpy as np
import pytest

from trueangle.contract.errors import ContractError
from trueangle_training import cli
from trueangle_training.genetic import GeneticOptions, MutationForm, mutate
from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnPaper, Fitness
from trueangle_training.methods.registry import METHODS, load_method
from trueangle_training.train_options import PAPER_OPTIONS, STATED_DEFAULTS, add_method_options, chosen_method


def parsed(*options: str, method: str = "fe-gabpnn-paper") -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_method_options(parser)
    arguments = parser.parse_args(["--method", method, *options])
    arguments.seed, arguments.threads = 0, 1
    return arguments


def chosen(*options: str, method: str = "fe-gabpnn-paper") -> FeGabpnnPaper:
    return cast("FeGabpnnPaper", chosen_method(parsed(*options, method=method), base_temperature_c=20.0))


def test_the_papers_method_is_the_text_to_the_letter_unless_told_otherwise() -> None:
    paper = chosen()
    assert paper.options.fitness is Fitness.UNTRAINED
    assert "to the letter" in METHODS["fe-gabpnn-paper"].summary
    assert paper.summary == METHODS["fe-gabpnn-paper"].summary


def test_the_stated_defaults_are_those_of_the_method() -> None:
    options = chosen().options
    lm, genetic = options.training, options.genetic
    found = {
        "order": options.order,
        "hidden_nodes": options.hidden_nodes,
        "individuals": genetic.individuals,
        "generations": genetic.generations,
        "fitness": options.fitness.value,
        "fitness_lm_steps": options.fitness_lm_steps,
        "mutation": genetic.mutation_form.value.replace(" ", "-"),
        "initial_range": genetic.initial_range,
        "parameter_bound": genetic.parameter_bound,
        "epochs": lm.max_epochs,
        "accepted_steps": lm.max_accepted_steps,
        "patience": lm.patience,
        "lm_damping": lm.initial_damping,
        "lm_accepted_factor": lm.accepted_factor,
        "lm_rejected_factor": lm.rejected_factor,
        "validation_fraction": options.validation_fraction,
    }
    assert found == STATED_DEFAULTS
    assert set(STATED_DEFAULTS) == set(PAPER_OPTIONS)
    others = {name: cast("FeGabpnnPaper", load_method(name)).options for name in ("fe-bpnn", "bpnn")}
    assert others["bpnn"].hidden_nodes == 25
    assert others["fe-bpnn"].hidden_nodes == 20
    for each in others.values():
        assert (each.genetic.individuals, each.genetic.generations) == (1, 0)
        assert each.training == lm
        assert each.validation_fraction == options.validation_fraction


@pytest.mark.parametrize("command", ["train"])
def test_help_states_a_default_for_every_option(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    group = text[text.index("the paper's networks:") :]
    for name in PAPER_OPTIONS:
        option = f"--{name.replace('_', '-')} "
        said = re.split(r" --[a-z]", group[group.index(option) + len(option) :])[0]
        assert "default" in said, option


def test_damping_its_factors_and_bounds_reach_the_training() -> None:
    options = chosen(
        *("--lm-damping", "0.01", "--lm-accepted-factor", "0.2", "--lm-rejected-factor", "5"),
        *("--parameter-bound", "2", "--mutation", "as-printed"),
    ).options
    lm = options.training
    assert (lm.initial_damping, lm.accepted_factor, lm.rejected_factor) == (0.01, 0.2, 5.0)
    assert options.genetic.parameter_bound == 2.0
    assert options.genetic.mutation_form is MutationForm.AS_PRINTED


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--epochs", "0"], "--epochs: expected 1 or more, found 0"),
        (["--lm-damping", "0"], "damping"),
        (["--lm-accepted-factor", "1.5"], "accepted_factor"),
        (["--parameter-bound", "0.5"], "parameter bound"),
    ],
)
def test_settings_that_train_nothing_are_refused(options: list[str], complaint: str) -> None:
    with pytest.raises(ContractError, match=complaint):
        chosen(*options)


def test_with_bounds_mutation_reaches_beyond_the_population_but_not_beyond_them() -> None:
    rng = np.random.default_rng(3)
    population = np.zeros((50, 4))
    for _ in range(20):
        mutate(population, 0.0, MutationForm.AS_MEANT, rng, bound=2.0)
    # All genes are equal: without bounds the extremes are the genes themselves and nothing moves.
    assert 1.0 < np.abs(population).max() <= 2.0
    unmoved = np.zeros((50, 4))
    mutate(unmoved, 0.0, MutationForm.AS_MEANT, rng)
    assert not unmoved.any()


def test_bounds_hold_the_first_genes() -> None:
    with pytest.raises(ValueError, match="parameter bound"):
        GeneticOptions(initial_range=2.0, parameter_bound=1.0)
