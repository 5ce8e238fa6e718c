"""The reference's own error: a fixed pattern over the faces of the polygon."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.joint import Joint
from trueangle.contract.units import DEG_PER_TURN
from trueangle_training.effects.cells import Cell
from trueangle_training.effects.checks import SignedAmplitude
from trueangle_training.effects.conditions import Conditions
from trueangle_training.effects.effect import Hypothesis, LibraryEffect, Nature, Parameter, Stage
from trueangle_training.effects.harmonics import HarmonicTerm
from trueangle_training.effects.patterns import no_columns

Floats = NDArray[np.float64]
LOW_ORDERS = (1, 2, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceArtefactSettings:
    """One deviation for each face."""

    faces_arcsec: tuple[SignedAmplitude, ...] | None = None
    """What faces 1, 2, ... add to the error, indicated minus reference; None: calibrated from data."""

    def terms(self, joint: Joint) -> tuple[HarmonicTerm, ...] | None:
        """No part of it is the joint's; ContractError unless each face of the polygon has its deviation."""
        if self.faces_arcsec is None:
            return None
        listed, faces = len(self.faces_arcsec), joint.reference.faces
        if faces is not None and listed != faces:
            fault = Fault(
                where="faces_arcsec",
                expected=f"{faces} deviations, one for each face of the reference",
                found="1 deviation" if listed == 1 else f"{listed} deviations",
                advice="list 0 for a face that was not measured",
            )
            raise ContractError([fault])
        return ()

    def error_arcsec(self, conditions: Conditions, joint: Joint, rng: np.random.Generator | None) -> Floats:
        """As in `EffectSettings`; 0 without faces and on faces that are not listed."""
        if conditions.face is None or self.faces_arcsec is None:
            return np.zeros(len(conditions))
        listed = np.concatenate([[0.0], self.faces_arcsec, [0.0]])
        return listed[np.minimum(conditions.face, listed.size - 1)]

    def columns(self, conditions: Conditions, joint: Joint) -> Floats:
        """One indicator for each face."""
        if conditions.face is None:
            return no_columns(len(conditions))
        return _indicators(conditions.face, int(conditions.face.max()))


def _indicators(face: NDArray[np.int64], faces: int) -> Floats:
    return (face[:, None] == np.arange(1, faces + 1)[None, :]).astype(np.float64)


def hypotheses(conditions: Conditions) -> Iterator[Hypothesis]:
    """Any pattern; where the polygon was re-mounted, also smooth ones. None without polygon faces."""
    if conditions.face is None or not conditions.face.any():
        return
    faces = max(conditions.faces or 0, int(conditions.face.max()))
    indicators = _indicators(conditions.face, faces)
    yield _hypothesis("any pattern over the faces", "1", indicators, tuple(range(1, faces + 1)))
    offset = conditions.polygon_offset
    if offset is not None and np.ptp(offset[conditions.face > 0]) > 0:
        for order in LOW_ORDERS:
            phase_rad = np.radians(order * DEG_PER_TURN / faces * np.arange(faces))
            waves = indicators @ np.column_stack([np.cos(phase_rad), np.sin(phase_rad)])
            yield Hypothesis(
                effect="reference_artefact",
                label=f"order {order} over the faces",
                cell=Cell(order=str(order), frame="polygon"),
                main=waves,
                coefficients=(f"order_{order}_cos_arcsec", f"order_{order}_sin_arcsec"),
                wiggle=no_columns(len(conditions)),
                shape={"order": float(order), "faces": float(faces)},
            )


def _hypothesis(label: str, order: str, main: Floats, faces: tuple[int, ...]) -> Hypothesis:
    return Hypothesis(
        effect="reference_artefact",
        label=label,
        cell=Cell(order=order, frame="polygon"),
        main=main,
        coefficients=tuple(f"face_{face}_arcsec" for face in faces),
        wiggle=no_columns(main.shape[0]),
    )


def settings_of(hypothesis: Hypothesis, coefficients: Floats) -> dict[str, Any]:
    """The deviation of each face."""
    if "faces" not in hypothesis.shape:
        return {"faces_arcsec": [float(value) for value in coefficients]}
    faces, order = int(hypothesis.shape["faces"]), hypothesis.shape["order"]
    phase_rad = np.radians(order * DEG_PER_TURN / faces * np.arange(faces))
    values = coefficients[0] * np.cos(phase_rad) + coefficients[1] * np.sin(phase_rad)
    return {"faces_arcsec": [float(value) for value in values]}


EFFECT = LibraryEffect(
    name="reference_artefact",
    nature=Nature.MEAN,
    physics="The faces of the polygon do not stand where the certificate says: measure it, do not compensate it.",
    formula="E = p(face), any pattern",
    source="calibration certificates of optical polygons, and their calibration by circle closure",
    parameters=(
        Parameter(
            name="faces_arcsec",
            unit="arcsec",
            low=-5.0,
            high=5.0,
            source="data sheets of 23-face polygons: 0.5 to 5 arcsec where no certificate is applied",
        ),
    ),
    cells=tuple(Cell(order=str(order), frame="polygon") for order in range(1, 12)),
    proof="Turn the polygon on the shaft by some faces and measure again: the pattern stays with the faces.",
    missing_input="reference",
    settings=ReferenceArtefactSettings,
    hypotheses=hypotheses,
    settings_of=settings_of,
    needs=("face",),
    stage=Stage.REFERENCE,
)
