"""The methods by their command-line names; a module is imported when its method is asked for, not before.

torch takes seconds to import and `linear`, `fepf` and `poly2d` do not need it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import cast

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.methods import Method

DEFAULT_METHOD = "fe-gabpnn"
DEFAULT_BASE_TEMPERATURE_C = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodEntry:
    """Where a method is to be found."""

    module: str
    """Under trueangle_training.methods; it offers `make(base_temperature_c: float) -> Method`."""
    summary: str
    free_offsets: bool = False
    """Whether the zero of every group of readings is estimated: groups may then be zeroed at different places."""
    needs_base_temperature: bool = False
    """Whether runs at the base temperature are needed."""
    paper_network: bool = False
    """Whether it is one of the paper's networks, with their options and a random part kept for validation."""
    seconds: float = 0.1
    """About what one training on 483 readings takes on one thread, to tell the cheap from the dear."""

    def load(self, base_temperature_c: float = DEFAULT_BASE_TEMPERATURE_C) -> Method:
        """Import the module and make the method with its default settings."""
        module = import_module(f"trueangle_training.methods.{self.module}")
        return cast("Callable[[float], Method]", module.make)(base_temperature_c)


METHODS: Mapping[str, MethodEntry] = {
    "fe-gabpnn": MethodEntry(
        module="fe_gabpnn",
        summary="Fourier series + GA-started LM network of the coefficients over temperature",
        free_offsets=True,
        seconds=1.0,
    ),
    "linear": MethodEntry(
        module="linear", summary="harmonics with smooth temperature terms, weighted by evidence", free_offsets=True
    ),
    "best": MethodEntry(
        module="best",
        summary="average of shared shapes, network and kernels: most accurate, about a second",
        free_offsets=True,
        seconds=1.5,
    ),
    "fe-gabpnn-paper": MethodEntry(
        module="fe_gabpnn_paper",
        summary="the paper's method, eqs. (1)-(10) to the letter but for the misprint in (10)",
        needs_base_temperature=True,
        paper_network=True,
        seconds=0.5,
    ),
    "fe-bpnn": MethodEntry(
        module="fe_bpnn",
        summary="the paper's network without the genetic algorithm",
        needs_base_temperature=True,
        paper_network=True,
    ),
    "bpnn": MethodEntry(
        module="bpnn", summary="the paper's plain network of angle and temperature, 25 nodes", paper_network=True
    ),
    "poly2d": MethodEntry(module="poly2d", summary="two-dimensional polynomial of degree 5, eq. (12)"),
    "fepf": MethodEntry(module="fepf", summary="harmonics 0-7 with coefficients of degree 5 in T, eqs. (13)-(14)"),
    "harmonics-poly": MethodEntry(
        module="harmonics_poly", summary="harmonics times a polynomial of temperature", free_offsets=True
    ),
    "angle-only": MethodEntry(
        module="angle_only",
        summary="harmonics at the base temperature, temperature ignored",
        needs_base_temperature=True,
    ),
}
"""`auto` is a choice among these and lives with the command that offers it."""


def load_method(name: str, *, base_temperature_c: float = DEFAULT_BASE_TEMPERATURE_C) -> Method:
    """The method of that name; ContractError lists the names there are.

    `base_temperature_c` matters to the methods of the paper only.
    """
    if name not in METHODS:
        raise ContractError([Fault(where="method", expected=f"one of {', '.join(METHODS)}", found=name)])
    return METHODS[name].load(base_temperature_c)
