"""The model file: loaded from bytes, checked against the contract, its probes replayed, then run.

The only module that touches ONNX Runtime. A file that disagrees in anything is refused as a whole, before the
first angle is served. Nothing of a graph is ever edited here.
"""

import hashlib
import math
import os
from array import array
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.metadata import (
    ANGLE_INPUT,
    CORRECTION_OUTPUT,
    METADATA_KEY,
    SEAL_KEY,
    TEMPERATURE_INPUT,
    UNCERTAINTY_OUTPUT,
    ModelMetadata,
    metadata_from_json,
    probe_disagreement,
    seal_holds,
)
from trueangle.core.correction import Correction, ModelAnswer

MAX_MODEL_BYTES = 16 * 2**20
_EXTERNAL_DATA = b"\x0a\x08location\x12"
"""How a tensor names a file beside the model (onnx.proto, TensorProto.external_data, key "location")."""


class OnnxModel:
    """One joint's model, checked and ready; see `load_model`."""

    def __init__(self, session: Any, metadata: ModelMetadata, sha256: str, *, has_uncertainty: bool) -> None:
        self._session = session
        self._outputs = [CORRECTION_OUTPUT, UNCERTAINTY_OUTPUT] if has_uncertainty else [CORRECTION_OUTPUT]
        self.metadata = metadata
        self.sha256 = sha256
        self._one = _OneSample(session, self._outputs)

    def correct_sample(self, raw_deg: float, temperature_c: float) -> Correction:
        """One sample; a run that fails gives NaN. From one thread at a time."""
        return self._one.run(raw_deg, temperature_c)

    def correct(self, angle_deg: NDArray[np.float64], temperature_c: NDArray[np.float64]) -> ModelAnswer:
        """Corrections for n samples, shapes [n]; a run that fails gives NaN, which `health` refuses."""
        feed = {ANGLE_INPUT: angle_deg, TEMPERATURE_INPUT: temperature_c}
        try:
            answers = cast("list[NDArray[np.float64]]", self._session.run(self._outputs, feed))
        except Exception:  # noqa: BLE001 - ONNX Runtime's own exceptions derive from Exception alone
            return ModelAnswer(correction_arcsec=np.full(angle_deg.shape, np.nan), uncertainty_arcsec=None)
        return ModelAnswer(
            correction_arcsec=answers[0], uncertainty_arcsec=answers[1] if len(answers) > 1 else None
        )


class _OneSample:
    """Runs the graph on memory that is bound to it once: no array is made and no name looked up in a run."""

    def __init__(self, session: Any, outputs: list[str]) -> None:
        self._session = session
        # array and not NumPy: to write and read single numbers is all that is done with them.
        self._angle_deg, self._temperature_c = array("d", [0.0]), array("d", [0.0])
        self._answers = [array("d", [math.nan]) for _ in outputs]
        self._binding = session.io_binding()
        memory = (self._angle_deg, self._temperature_c)
        for name, one in zip((ANGLE_INPUT, TEMPERATURE_INPUT), memory, strict=True):
            self._binding.bind_input(name, "cpu", 0, np.float64, (1,), one.buffer_info()[0])
        for name, one in zip(outputs, self._answers, strict=True):
            self._binding.bind_output(name, "cpu", 0, np.float64, (1,), one.buffer_info()[0])

    def run(self, raw_deg: float, temperature_c: float) -> Correction:
        self._angle_deg[0], self._temperature_c[0] = raw_deg, temperature_c
        # The last sample's answer must never pass for this one's.
        for answer in self._answers:
            answer[0] = math.nan
        try:
            self._session.run_with_iobinding(self._binding)
        except Exception:  # noqa: BLE001 - ONNX Runtime's own exceptions derive from Exception alone
            return Correction(math.nan, None)
        return Correction(self._answers[0][0], self._answers[1][0] if len(self._answers) > 1 else None)


def load_model(path: Path, *, pinned_sha256: str | None = None) -> OnnxModel:
    """Read, check and replay a model file; ContractError says what was expected and found."""
    where = str(path)
    data = _read(path)
    sha256 = hashlib.sha256(data).hexdigest()
    if pinned_sha256 is not None and sha256 != pinned_sha256:
        raise _refusal(where, f"the pinned SHA-256 {pinned_sha256}", sha256)
    if _EXTERNAL_DATA in data:
        raise _refusal(where, "all weights inside the file", "a reference to external data")
    session = _session(data, where)
    try:
        has_uncertainty = _check_signature(session, where)
        entries = cast("dict[str, str]", session.get_modelmeta().custom_metadata_map)
    except UnicodeDecodeError as error:
        raise _refusal(where, "names and metadata in UTF-8", str(error), "is the file damaged?") from error
    text = entries.get(METADATA_KEY)
    if text is None:
        raise _refusal(
            where, f"metadata under the key {METADATA_KEY}", "none", "was it written by trueangle train?"
        )
    model = OnnxModel(
        session, metadata_from_json(text, source=f"{where} metadata"), sha256, has_uncertainty=has_uncertainty
    )
    if not seal_holds(data, entries.get(SEAL_KEY)):
        found = "another" if SEAL_KEY in entries else "none"
        raise _refusal(where, f"the file's own SHA-256 under {SEAL_KEY}", found, "the file was changed or damaged")
    _replay(model, where)
    return model


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_MODEL_BYTES + 1)
    except (OSError, ValueError) as error:
        # ValueError: a name that no file can have, with a NUL or half a surrogate in it.
        found = getattr(error, "strerror", None) or str(error)
        raise _refusal(str(path), "a readable model file", found) from error
    if len(data) > MAX_MODEL_BYTES:
        raise _refusal(str(path), f"at most {MAX_MODEL_BYTES} bytes", "a larger file")
    if not data:
        raise _refusal(str(path), "an ONNX model", "an empty file")
    return data


def _session(data: bytes, where: str) -> Any:
    # ONNX Runtime starts its telemetry, a network client, when it is imported: it must be told before. That is why
    # it is imported here and not above; commands that need no model then also start without it.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime  # pyright: ignore[reportMissingTypeStubs]

    runtime = cast("Any", onnxruntime)  # it ships no type information
    options = runtime.SessionOptions()
    # One sample a pass: threads would cost more than the whole graph. Fatal only: refusals are our own messages.
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # An arena for each joint's model would keep as many sets of working memory out of the processor's cache.
    options.enable_cpu_mem_arena = False
    try:
        return runtime.InferenceSession(
            data, sess_options=options, providers=["CPUExecutionProvider"], enable_fallback=False
        )
    except Exception as error:  # a damaged file raises types that the runtime does not export
        found = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise _refusal(where, "an ONNX model that ONNX Runtime can load", found, "is the file damaged?") from error


def _check_signature(session: Any, where: str) -> bool:
    """Names, types and shapes of the graph; True when it gives an uncertainty."""
    faults: list[Fault] = []
    inputs = {item.name: item for item in session.get_inputs()}
    outputs = {item.name: item for item in session.get_outputs()}
    wanted_inputs = [ANGLE_INPUT, TEMPERATURE_INPUT]
    if list(inputs) != wanted_inputs:
        faults.append(
            Fault(where=where, expected=f"the inputs {', '.join(wanted_inputs)}", found=", ".join(inputs))
        )
    wanted_outputs = ([CORRECTION_OUTPUT], [CORRECTION_OUTPUT, UNCERTAINTY_OUTPUT])
    if list(outputs) not in wanted_outputs:
        expected = f"the outputs {CORRECTION_OUTPUT} and at most {UNCERTAINTY_OUTPUT}"
        faults.append(Fault(where=where, expected=expected, found=", ".join(outputs)))
    for name, item in {**inputs, **outputs}.items():
        shape = list(item.shape)
        if item.type != "tensor(double)" or len(shape) != 1 or isinstance(shape[0], int):
            found = f"{item.type} {shape}"
            faults.append(Fault(where=f"{where}, {name}", expected="tensor(double) of shape [n]", found=found))
    if faults:
        raise ContractError(faults)
    return UNCERTAINTY_OUTPUT in outputs


def _replay(model: OnnxModel, where: str) -> None:
    """Every probe must come out as the trainer wrote it, and an empty batch must be empty."""
    probes = model.metadata.probes
    answer = model.correct(np.array(probes.angle_deg), np.array(probes.temperature_c))
    uncertainty = answer.uncertainty_arcsec
    disagreement = probe_disagreement(
        probes,
        correction_arcsec=answer.correction_arcsec.tolist(),
        uncertainty_arcsec=None if uncertainty is None else uncertainty.tolist(),
        tolerance_arcsec=model.metadata.probe_tolerance_arcsec,
    )
    if disagreement is None:
        disagreement = _disagreement_one_by_one(model)
    if disagreement is not None:
        raise _refusal(where, "probes that come out as they were written", disagreement)
    datum_deg, valid_c = model.metadata.datum_deg, model.metadata.valid_temperature_c
    at_datum = model.correct(np.full(3, datum_deg), np.linspace(valid_c.minimum, valid_c.maximum, 3))
    if np.any(at_datum.correction_arcsec != 0.0):
        found = str(at_datum.correction_arcsec)
        raise _refusal(where, f"a correction of 0 at the datum ({datum_deg:g} deg)", found)
    if model.correct(np.empty(0), np.empty(0)).correction_arcsec.shape != (0,):
        raise _refusal(where, "an empty result for no samples", "values")


def _disagreement_one_by_one(model: OnnxModel) -> str | None:
    """The probes again, each a pass of its own as in service."""
    probes = model.metadata.probes
    answers = [
        model.correct_sample(angle_deg, temperature_c)
        for angle_deg, temperature_c in zip(probes.angle_deg, probes.temperature_c, strict=True)
    ]
    uncertainty = [one.uncertainty_arcsec for one in answers if one.uncertainty_arcsec is not None]
    return probe_disagreement(
        probes,
        correction_arcsec=[one.correction_arcsec for one in answers],
        uncertainty_arcsec=uncertainty or None,
        tolerance_arcsec=model.metadata.probe_tolerance_arcsec,
    )


def _refusal(where: str, expected: str, found: str, advice: str = "") -> ContractError:
    return ContractError([Fault(where=where, expected=expected, found=found, advice=advice)])
