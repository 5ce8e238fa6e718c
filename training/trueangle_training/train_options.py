"""The methods and their options on the command line: each option left out keeps the method's own default."""

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.methods import Method
from trueangle_training.methods.registry import DEFAULT_METHOD, METHODS, load_method

if TYPE_CHECKING:
    from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnOptions, FeGabpnnPaper

AUTO = "auto"
FITNESS_CHOICES = ("untrained", "after_lm", "after_lm_handed_on")
MUTATION_CHOICES = ("as-meant", "as-printed")
PAPER_OPTIONS = (
    "order",
    "hidden_nodes",
    "individuals",
    "generations",
    "fitness",
    "fitness_lm_steps",
    "mutation",
    "initial_range",
    "epochs",
    "accepted_steps",
    "patience",
    "validation_fraction",
)


def add_method_options(parser: argparse.ArgumentParser) -> None:
    """Offer the methods and the options of the paper's networks, without drawing in any method itself."""
    listed = "; ".join(f"{name}: {entry.summary}" for name, entry in METHODS.items())
    parser.add_argument(
        "--method",
        choices=(*METHODS, AUTO),
        default=DEFAULT_METHOD,
        metavar="NAME",
        help=f"{listed}; {AUTO}: the best of the quick ones by leave-one-temperature-out "
        f"(default {DEFAULT_METHOD})".replace("%", "%%"),
    )
    networks = ", ".join(name for name, entry in METHODS.items() if entry.paper_network)
    group = parser.add_argument_group(f"the paper's networks: {networks} (left out: the method's default)")
    group.add_argument("--order", type=int, metavar="N", help="harmonics of the base")
    group.add_argument("--hidden-nodes", type=int, metavar="N", help="nodes of the hidden layer")
    group.add_argument("--individuals", type=int, metavar="N", help="individuals of the genetic algorithm")
    group.add_argument("--generations", type=int, metavar="N", help="generations; 0: random initial weights only")
    group.add_argument("--fitness", choices=FITNESS_CHOICES, help="what an individual is rated by")
    group.add_argument("--fitness-lm-steps", type=int, metavar="N", help="steps before rating, unless untrained")
    group.add_argument("--mutation", choices=MUTATION_CHOICES, help="which reading of eq. (10)")
    group.add_argument("--initial-range", type=float, metavar="X", help="initial weights lie within -X to X")
    group.add_argument("--epochs", type=int, metavar="N", help="Levenberg-Marquardt trial steps at most")
    group.add_argument("--accepted-steps", type=int, metavar="N", help="and accepted ones (epochs of trainlm)")
    group.add_argument(
        "--patience", type=int, metavar="N", help="steps without a better validation before stopping"
    )
    group.add_argument("--validation-fraction", type=float, metavar="X", help="share kept back for early stopping")


def chosen_method(arguments: argparse.Namespace, *, base_temperature_c: float) -> Method:
    """The method of `--method`, which is not `auto`, with the options given; ContractError for what it refuses."""
    faults = option_faults(arguments)
    if faults:
        raise ContractError(faults)
    method = load_method(arguments.method, base_temperature_c=base_temperature_c)
    if not METHODS[arguments.method].paper_network:
        return method
    paper = cast("FeGabpnnPaper", method)
    return replace(paper, options=_with_options(paper.options, arguments))


def option_faults(arguments: argparse.Namespace) -> list[Fault]:
    """What can be said of the options without the method itself."""
    faults: list[Fault] = []
    for name, lowest in (("seed", 0), ("threads", 1)):
        if getattr(arguments, name) < lowest:
            found = str(getattr(arguments, name))
            faults.append(Fault(where=f"--{name}", expected=f"{lowest} or more", found=found))
    entry = METHODS.get(arguments.method)
    given = [name for name in PAPER_OPTIONS if getattr(arguments, name) is not None]
    if given and (entry is None or not entry.paper_network):
        found = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        networks = ", ".join(name for name, each in METHODS.items() if each.paper_network)
        faults.append(
            Fault(
                where="options",
                expected=f"no options of the paper's networks with --method {arguments.method}",
                found=found,
                advice=f"they belong to {networks}",
            )
        )
    return faults


def _with_options(options: "FeGabpnnOptions", arguments: argparse.Namespace) -> "FeGabpnnOptions":
    from trueangle_training.genetic import MutationForm
    from trueangle_training.methods.fe_gabpnn_paper import Fitness

    mutation = arguments.mutation and MutationForm(arguments.mutation.replace("-", " "))
    genetic = _given(
        individuals=arguments.individuals,
        generations=arguments.generations,
        mutation_form=mutation,
        initial_range=arguments.initial_range,
    )
    training = _given(
        max_epochs=arguments.epochs,
        max_accepted_steps=arguments.accepted_steps,
        patience=arguments.patience,
    )
    try:
        return replace(
            options,
            genetic=replace(options.genetic, **genetic),
            training=replace(options.training, **training),
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


def excluded_rows(text: str) -> frozenset[int]:
    """File lines as in `17,40-62`; argparse tells the user what a ValueError means."""
    rows: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        rows.update(range(int(first), int(last or first) + 1))
    return frozenset(rows)
