"""The method's options on the command line: each one left out keeps the method's own default."""

import argparse
from typing import TYPE_CHECKING, Any

from trueangle.contract.errors import ContractError, Fault

if TYPE_CHECKING:
    from trueangle_training.methods.fe_gabpnn import FeGabpnnOptions

FITNESS_CHOICES = ("untrained", "after_lm", "after_lm_handed_on")
MUTATION_CHOICES = ("as-meant", "as-printed")


def add_method_options(parser: argparse.ArgumentParser) -> None:
    """Offer the options of FE-GABPNN, without drawing in the method itself."""
    group = parser.add_argument_group("method FE-GABPNN (left out: the method's default)")
    group.add_argument("--order", type=int, metavar="N", help="harmonics of the base")
    group.add_argument("--hidden-nodes", type=int, metavar="N", help="nodes of the hidden layer")
    group.add_argument("--individuals", type=int, metavar="N", help="individuals of the genetic algorithm")
    group.add_argument("--generations", type=int, metavar="N", help="generations; 0: random initial weights only")
    group.add_argument("--fitness", choices=FITNESS_CHOICES, help="what an individual is rated by")
    group.add_argument("--fitness-lm-steps", type=int, metavar="N", help="steps before rating, unless untrained")
    group.add_argument("--mutation", choices=MUTATION_CHOICES, help="which reading of eq. (10)")
    group.add_argument("--epochs", type=int, metavar="N", help="Levenberg-Marquardt epochs at most")
    group.add_argument(
        "--patience", type=int, metavar="N", help="steps without a better validation before stopping"
    )
    group.add_argument("--validation-fraction", type=float, metavar="X", help="share kept back for early stopping")


def method_options(
    arguments: argparse.Namespace, *, base_temperature_c: float, datum_deg: float
) -> "FeGabpnnOptions":
    """The options as the method takes them; ContractError for what it does not accept."""
    from trueangle_training.genetic import GeneticOptions, MutationForm
    from trueangle_training.levenberg_marquardt import LevenbergMarquardtOptions
    from trueangle_training.methods.fe_gabpnn import FeGabpnnOptions, Fitness

    if arguments.seed < 0:
        raise ContractError([Fault(where="--seed", expected="0 or more", found=str(arguments.seed))])
    mutation = arguments.mutation and MutationForm(arguments.mutation.replace("-", " "))
    try:
        return FeGabpnnOptions(
            base_temperature_c=base_temperature_c,
            datum_deg=datum_deg,
            genetic=GeneticOptions(
                **_given(
                    individuals=arguments.individuals, generations=arguments.generations, mutation_form=mutation
                )
            ),
            training=LevenbergMarquardtOptions(**_given(max_epochs=arguments.epochs, patience=arguments.patience)),
            seed=arguments.seed,
            threads=arguments.threads,
            **_given(
                order=arguments.order,
                hidden_nodes=arguments.hidden_nodes,
                fitness=arguments.fitness and Fitness(arguments.fitness),
                fitness_lm_steps=arguments.fitness_lm_steps,
                validation_fraction=arguments.validation_fraction,
            ),
        )
    except ContractError:
        raise
    except ValueError as error:
        raise ContractError(
            [Fault(where="options", expected="settings to train with", found=str(error))]
        ) from error


def _given(**values: Any) -> dict[str, Any]:
    """Those that were given."""
    return {name: value for name, value in values.items() if value is not None}
