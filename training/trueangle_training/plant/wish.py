"""What is asked of a plant."""

from dataclasses import dataclass
from typing import Literal

from trueangle_training.plant.schedule import PlanName

Stratum = Literal["noise", "parametric", "single", "pair", "confounded", "unknown", "withheld", "broken"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What a case shall be; everything else is drawn from its seed."""

    seed: int
    plan: PlanName
    stratum: Stratum
    enr: float = 1.0
    """Of the first effect."""
    names: tuple[str, ...] = ()
    """Effects of the library, or families of the unknown, one or two; of a broken case its data fault."""
    ratio: float = 1.0
    """Second effect's size to the first one's."""
    plant: str = "A"
    """Letter of the plant that makes it."""
    unlisted: tuple[str, ...] = ()
    """Effects of the library that JOINT.yaml does not list, and that the joint does not have either.

    What a joint lacks is never listed: without these, a short list would tell that something is wrong.
    """
