"""What settings of effects have in common: the ranges of their numbers and the checks between them."""

from collections.abc import Sequence
from typing import Annotated

from trueangle.contract.document import Range
from trueangle.contract.errors import ContractError, Fault
from trueangle_training.effects.harmonics import Order

DEFAULT_LAST_ORDER = 11
Amplitude = Annotated[float, Range(minimum=0, maximum=36_000)]
"""The sign is in the phase; beyond 10 deg it is no longer an error but another angle."""
SignedAmplitude = Annotated[float, Range(minimum=-36_000, maximum=36_000)]
"""Of a shape that has no phase."""
Phase = Annotated[float, Range(minimum=-360, maximum=360)]
Degree = Annotated[int, Range(minimum=1, maximum=5)]
LowOrder = Annotated[int, Range(minimum=0, maximum=2)]
TimeConstant = Annotated[float, Range(minimum=1, maximum=1e6)]


def both_or_neither(first: str, first_value: float | None, second: str, second_value: float | None) -> None:
    """ContractError where only one half of an amplitude with its phase is given."""
    if (first_value is None) != (second_value is None):
        given, missing = (second, first) if first_value is None else (first, second)
        raise ContractError([Fault(where=given, expected=f"{missing} beside {given}", found=f"no {missing}")])


def order_span(orders: tuple[int, int] | None, faces: int | None) -> tuple[int, int]:
    """First and last order; by default 3 to min(11, (faces - 1) // 2), the last that the faces resolve."""
    if orders is not None:
        return orders
    return 3, DEFAULT_LAST_ORDER if faces is None else min(DEFAULT_LAST_ORDER, (faces - 1) // 2)


def check_orders(orders: tuple[int, int] | None, *, minimum: int) -> None:
    """ContractError unless the span runs upwards from an order that the effect may have."""
    if orders is not None and not minimum <= orders[0] <= orders[1]:
        expected = f"[first, last] with {minimum} <= first <= last"
        raise ContractError([Fault(where="orders", expected=expected, found=str(list(orders)))])


def check_harmonics(present: Sequence[Order], *, span: tuple[int, int]) -> None:
    """ContractError where an order stands twice or lies outside the span that the effect models."""
    faults = [
        Fault(where="harmonics", expected="each order once", found=f"order {order} {present.count(order)} times")
        for order in sorted(set(present))
        if present.count(order) > 1
    ]
    faults += [
        Fault(
            where="harmonics",
            expected=f"orders {span[0]} to {span[1]}",
            found=f"order {order}",
            advice="widen the key orders",
        )
        for order in sorted(set(present))
        if not span[0] <= order <= span[1]
    ]
    if faults:
        raise ContractError(faults)


def linear_only(degree: int) -> None:
    """ContractError for a degree that the nominal per-kelvin amplitude cannot describe."""
    if degree > 1:
        raise ContractError(
            [
                Fault(
                    where="degree",
                    expected="1 beside a nominal amplitude per kelvin",
                    found=str(degree),
                    advice="the quadratic part is simulated by thermal_nonlinearity",
                )
            ]
        )
