"""Stages of a training that several methods begin with, done once for the same readings.

`linear`, `fe-gabpnn` and `best` are built on each other. A comparison trains all of them on the same parts of a
campaign: what one has worked out the next need not.
"""

import hashlib
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, cast, runtime_checkable

from trueangle_training.methods import Method, TrainingReadings

Made = TypeVar("Made")


@dataclass(slots=True)
class Stages:
    """What has been made, by stage, readings and settings; some megabytes for each set of readings."""

    _made: dict[Hashable, object] = field(default_factory=dict)

    def once(self, stage: str, readings: TrainingReadings, settings: Hashable, make: Callable[[], Made]) -> Made:
        """What `make` gives, or gave for the same stage, readings and settings."""
        key = (stage, _digest(readings), settings)
        if key not in self._made:
            self._made[key] = make()
        return cast("Made", self._made[key])


@runtime_checkable
class StagedMethod(Method, Protocol):
    """A method that can take stages from others."""

    def sharing(self, stages: Stages) -> Method:
        """The method with these stages; it gives the same models as without."""
        ...


def staged(
    stages: Stages | None, stage: str, readings: TrainingReadings, settings: Hashable, make: Callable[[], Made]
) -> Made:
    """`Stages.once`, or simply `make` where nothing is shared."""
    return make() if stages is None else stages.once(stage, readings, settings, make)


def _digest(readings: TrainingReadings) -> bytes:
    digest = hashlib.sha256(repr(readings.datum_deg).encode())
    group = readings.run if readings.zero_group is None else readings.zero_group
    for column in (readings.angle_deg, readings.error_arcsec, readings.temperature_c, readings.run, group):
        digest.update(column.tobytes())
    return digest.digest()
