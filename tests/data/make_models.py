"""Writes the model files that the daemon's tests read: one good, the others broken in one way each.

Run from the checkout as `python tests/data/make_models.py`; needs the training extra. The files are kept in the
repository, so that the daemon's tests run where the extra is not installed.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import TensorProto, numpy_helper

from trueangle.contract.metadata import METADATA_KEY, OPEN_SEAL, SEAL_KEY, sealed
from trueangle.laboratory import main as trueangle

EXAMPLES = Path(__file__).parents[2] / "training" / "trueangle_training" / "examples"
MODELS = Path(__file__).parent / "models"
SETTINGS = {"serial_number": 4711, "operating_parameters": 4, "units_per_revolution": 3276800, "preset_value": 0}


def main() -> int:
    """Train the good model and break copies of it."""
    MODELS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        good = _train(Path(scratch))
    _save("good", good)
    # The same graph for another joint: a file of its own, because one model on two joints is refused.
    _save("twin", _changed(good, metadata=_metadata(good) | {"joint": "twin"}))
    _save("no-metadata", _changed(good, metadata=None))
    _save("newer-metadata", _changed(good, metadata=_metadata(good) | {"schema_version": 2}))
    partial = _metadata(good)
    partial["inputs"][0]["range"] = {"minimum": 0.0, "maximum": 180.0}
    _save("partial", _changed(good, metadata=partial))
    disagreeing = _metadata(good)
    disagreeing["probes"]["correction_arcsec"][7] += 2e-6
    _save("probe-disagrees", _changed(good, metadata=disagreeing))
    _save("wrong-inputs", _renamed(good))
    _save("float32", _as_float32(good))
    _save("flipped-weight", _flipped(good))
    _save("external-data", _external(good))
    return 0


def _train(scratch: Path) -> onnx.ModelProto:
    joint = yaml.safe_load((EXAMPLES / "joint.yaml").read_text("utf-8"))
    joint["encoder"]["settings"] = SETTINGS
    (scratch / "joint.yaml").write_text(yaml.safe_dump(joint), "utf-8")
    files = [str(scratch / name) for name in ("joint.yaml", "campaign.csv", "good.onnx")]
    plan = str(EXAMPLES / "plan.yaml")
    assert trueangle(["simulate", "--joint", files[0], "--plan", plan, "--seed", "1", "-o", files[1]]) == 0
    command = ["train", files[1], "--joint", files[0], "-o", files[2], "--seed", "1"]
    command += ["--method", "fe-gabpnn-paper", "--fitness", "untrained"]
    assert trueangle([*command, "--calibrated", "2026-11-22", "--due", "2027-11-22"]) == 0
    return onnx.load(files[2])


def _metadata(model: onnx.ModelProto) -> dict[str, Any]:
    return json.loads(next(entry.value for entry in model.metadata_props if entry.key == METADATA_KEY))


def _changed(model: onnx.ModelProto, *, metadata: dict[str, Any] | None) -> onnx.ModelProto:
    changed = onnx.ModelProto()
    changed.CopyFrom(model)
    del changed.metadata_props[:]
    if metadata is not None:
        changed.metadata_props.add(key=METADATA_KEY, value=json.dumps(metadata, sort_keys=True))
    return changed


def _copy(model: onnx.ModelProto) -> onnx.ModelProto:
    return _changed(model, metadata=_metadata(model))


def _renamed(model: onnx.ModelProto) -> onnx.ModelProto:
    changed = _copy(model)
    changed.graph.input[0].name = "theta"
    for node in changed.graph.node:
        node.input[:] = ["theta" if name == "angle_deg" else name for name in node.input]
    return changed


def _as_float32(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph behind casts: inputs and output are float32, as a careless exporter would leave them."""
    changed = _copy(model)
    graph = changed.graph
    for node in graph.node:
        node.input[:] = [f"{name}_f64" if name in ("angle_deg", "temperature_c") else name for name in node.input]
        node.output[:] = [f"{name}_f64" if name == "correction_arcsec" else name for name in node.output]
    casts = [
        onnx.helper.make_node("Cast", [name], [f"{name}_f64"], to=TensorProto.DOUBLE)
        for name in ("angle_deg", "temperature_c")
    ]
    back = onnx.helper.make_node("Cast", ["correction_arcsec_f64"], ["correction_arcsec"], to=TensorProto.FLOAT)
    nodes = [*casts, *graph.node, back]
    del graph.node[:]
    graph.node.extend(nodes)
    for value in (*graph.input, *graph.output):
        if value.name != "uncertainty_arcsec":
            value.type.tensor_type.elem_type = TensorProto.FLOAT
    return changed


def _largest_weights(model: onnx.ModelProto) -> TensorProto:
    return max(
        (w for w in model.graph.initializer if w.data_type == TensorProto.DOUBLE), key=lambda w: w.ByteSize()
    )


def _flipped(model: onnx.ModelProto) -> onnx.ModelProto:
    changed = _copy(model)
    weights = _largest_weights(changed)
    values = numpy_helper.to_array(weights).copy()
    largest = np.unravel_index(np.argmax(np.abs(values)), values.shape)
    values[largest] = -values[largest]
    weights.CopyFrom(numpy_helper.from_array(values, weights.name))
    return changed


def _external(model: onnx.ModelProto) -> onnx.ModelProto:
    changed = _copy(model)
    weights = _largest_weights(changed)
    weights.ClearField("raw_data")
    weights.data_location = TensorProto.EXTERNAL
    weights.external_data.add(key="location", value="weights.bin")
    return changed


def _save(name: str, model: onnx.ModelProto) -> None:
    """Every file is sealed anew, so that each is refused for its own fault."""
    copy = onnx.ModelProto()
    copy.CopyFrom(model)
    others = {entry.key: entry.value for entry in copy.metadata_props if entry.key != SEAL_KEY}
    del copy.metadata_props[:]
    for key, value in {**others, SEAL_KEY: OPEN_SEAL}.items():
        copy.metadata_props.add(key=key, value=value)
    (MODELS / f"{name}.onnx").write_bytes(sealed(copy.SerializeToString(deterministic=True)))


if __name__ == "__main__":
    sys.exit(main())
