"""The model as it will be served: the file itself, asked by ONNX Runtime, whatever method made it."""

import hashlib
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import (
    ANGLE_INPUT,
    CORRECTION_OUTPUT,
    METADATA_KEY,
    TEMPERATURE_INPUT,
    UNCERTAINTY_OUTPUT,
    ModelMetadata,
    metadata_from_json,
)

Floats = NDArray[np.float64]


class Corrections(Protocol):
    """What the report asks of a model."""

    def correction_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """Correction at each pair, shape [n]."""
        ...

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats | None:
        """Its standard uncertainty (k = 1), shape [n]; None: the model serves none."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ServedModel:
    """A model file ready to be asked: `Corrections` with what the file says of itself."""

    session: Any
    """An `onnxruntime.InferenceSession`, which is not imported before it is needed."""
    outputs: frozenset[str]
    metadata: ModelMetadata
    sha256: str
    """Of the file's bytes."""
    source: str

    def correction_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats:
        """Correction at each pair, shape [n]."""
        return self._ask(CORRECTION_OUTPUT, angle_deg, temperature_c)

    def uncertainty_arcsec(self, angle_deg: Floats, temperature_c: Floats) -> Floats | None:
        """Its standard uncertainty (k = 1), shape [n]; None: the file serves none."""
        if UNCERTAINTY_OUTPUT not in self.outputs:
            return None
        return self._ask(UNCERTAINTY_OUTPUT, angle_deg, temperature_c)

    def _ask(self, output: str, angle_deg: Floats, temperature_c: Floats) -> Floats:
        feeds = {ANGLE_INPUT: angle_deg, TEMPERATURE_INPUT: temperature_c}
        return np.asarray(self.session.run([output], feeds)[0], dtype=np.float64)


def served_model(data: bytes, *, source: str) -> ServedModel:
    """The model in a file's bytes; ContractError where it is no model file of this product."""
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        found = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ContractError([Fault(where=source, expected="an ONNX model file", found=found)]) from error
    entries = session.get_modelmeta().custom_metadata_map
    if METADATA_KEY not in entries:
        expected = f"a model file with the metadata entry {METADATA_KEY}"
        raise ContractError([Fault(where=source, expected=expected, found=", ".join(entries) or "none")])
    outputs = frozenset(output.name for output in session.get_outputs())
    if CORRECTION_OUTPUT not in outputs:
        found = ", ".join(sorted(outputs))
        raise ContractError([Fault(where=source, expected=f"an output {CORRECTION_OUTPUT}", found=found)])
    return ServedModel(
        session=session,
        outputs=outputs,
        metadata=metadata_from_json(entries[METADATA_KEY], source=source),
        sha256=hashlib.sha256(data).hexdigest(),
        source=source,
    )
