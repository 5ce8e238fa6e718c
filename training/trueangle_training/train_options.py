"""The methods and their options on the command line: each option left out keeps the method's own default."""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, cast

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.methods import Method
from trueangle_training.methods.registry import DEFAULT_METHOD, METHODS, load_method

if TYPE_CHECKING:
    from trueangle_training.methods.fe_gabpnn_paper import FeGabpnnOptions, FeGabpnnPaper

AUTO = "auto"
FITNESS_CHOICES = ("untrained", "after_lm", "after_lm_handed_on")
MUTATION_CHOICES = ("as-meant", "as-printed")
STATED_DEFAULTS: Mapping[str, str | float | None] = {
    "order": None,
    "hidden_nodes": 20,
    "individuals": 30,
    "generations": 25,
    "fitness": "untrained",
    "fitness_lm_steps": 20,
    "mutation": "as-meant",
    "initial_range": 1.0,
    "parameter_bound": None,
    "epochs": 100,
    "accepted_steps": None,
    "patience": 6,
    "lm_damping": 1e-3,
    "lm_accepted_factor": 0.1,
    "lm_rejected_factor": 10.0,
    "validation_fraction": 0.1,
}
"""Of fe-gabpnn-paper, by option; repeated here because the method itself draws in torch, for which nobody waits
who asks for help. None: what the help says in words."""
PAPER_OPTIONS = tuple(STATED_DEFAULTS)


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
    group = parser.add_argument_group(f"the paper's networks: {networks}")
    _add_genetic_options(group)
    _add_training_options(group)


class _Group(Protocol):
    """Of argparse, whose own class is private."""

    def add_argument(self, *name_or_flags: str, **settings: Any) -> argparse.Action:
        """As argparse has it."""
        ...


def _add(group: _Group, name: str, kind: type, metavar: str, text: str, default: str | None = None) -> None:
    """One option; `default` in words where a number alone does not say it."""
    stated = STATED_DEFAULTS[name]
    words = default or (f"{stated:g}" if isinstance(stated, int | float) else str(stated))
    group.add_argument(f"--{name.replace('_', '-')}", type=kind, metavar=metavar, help=f"{text} (default {words})")


def _add_genetic_options(group: _Group) -> None:
    only_first = "with fe-bpnn and bpnn"
    _add(group, "order", int, "N", "harmonics of the base", "11, or as many as the angles allow")
    _add(group, "hidden_nodes", int, "N", "nodes of the hidden layer", "20; 25 with bpnn")
    _add(group, "individuals", int, "N", "individuals of the genetic algorithm", f"30; 1 {only_first}")
    _add(group, "generations", int, "N", "generations; 0: random initial weights only", f"25; 0 {only_first}")
    group.add_argument(
        "--fitness",
        choices=FITNESS_CHOICES,
        help="what an individual is rated by: its own weights, eq. (7) to the letter; weights after some "
        "Levenberg-Marquardt steps; or the same with these weights handed on to the training "
        f"(default {STATED_DEFAULTS['fitness']})",
    )
    _add(group, "fitness_lm_steps", int, "N", "steps before rating, unless untrained")
    group.add_argument(
        "--mutation",
        choices=MUTATION_CHOICES,
        help="which reading of eq. (10): as printed, both branches lower the parameter, surely a misprint "
        f"(default {STATED_DEFAULTS['mutation']})",
    )
    _add(group, "initial_range", float, "X", "initial weights lie within -X to X")
    bounds = "the largest and smallest of the parameter in the population, as in the paper"
    _add(group, "parameter_bound", float, "X", "a_max = X and a_min = -X of eq. (10)", bounds)


def _add_training_options(group: _Group) -> None:
    _add(group, "epochs", int, "N", "Levenberg-Marquardt trial steps at most")
    _add(group, "accepted_steps", int, "N", "and accepted ones (epochs of trainlm)", "no limit of their own")
    _add(group, "patience", int, "N", "accepted steps without a better validation before stopping")
    _add(group, "lm_damping", float, "X", "first damping of Levenberg-Marquardt")
    _add(group, "lm_accepted_factor", float, "X", "factor of the damping after a step that is taken")
    _add(group, "lm_rejected_factor", float, "X", "and after one that is dropped")
    _add(group, "validation_fraction", float, "X", "share of the readings kept back for early stopping")


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
    if arguments.epochs is not None and arguments.epochs < 1:
        faults.append(Fault(where="--epochs", expected="1 or more", found=str(arguments.epochs)))
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
        parameter_bound=arguments.parameter_bound,
    )
    training = _given(
        max_epochs=arguments.epochs,
        max_accepted_steps=arguments.accepted_steps,
        patience=arguments.patience,
        initial_damping=arguments.lm_damping,
        accepted_factor=arguments.lm_accepted_factor,
        rejected_factor=arguments.lm_rejected_factor,
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
