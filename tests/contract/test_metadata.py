"""Model metadata: the dataclasses and the shipped JSON schema agree on what is legal."""

import copy
import json
from typing import Any

import jsonschema
import pytest

from trueangle.contract.errors import ContractError
from trueangle.contract.metadata import (
    Probes,
    metadata_from_json,
    metadata_schema,
    metadata_to_json,
    probe_disagreement,
)

DOCUMENT: dict[str, Any] = {
    "schema_version": 1,
    "joint": "wrist",
    "method": "fe-gabpnn",
    "method_settings": {"hidden_nodes": 20, "ga": {"individuals": 30}},
    "inputs": [
        {"name": "angle_deg", "unit": "deg", "range": {"minimum": 0.0, "maximum": 360.0}},
        {"name": "temperature_c", "unit": "degC", "range": {"minimum": 10.0, "maximum": 40.0}},
    ],
    "sign_convention": "corrected = raw + correction",
    "temperature_used": True,
    "datum_deg": 0.0,
    "encoder": {"lines_per_rev": 16384, "counts_per_rev": 3276800, "settings": {"serial_number": 7}},
    "calibration": {"id": "c-1", "file_sha256": "0" * 64, "readings": 483, "date": "2026-11-22"},
    "reference": {"kind": "polygon", "faces": 23, "standard_uncertainty_arcsec": 0.125},
    "errors": {"in_sample_rmse_arcsec": 0.85},
    "seed": 1,
    "versions": {"trueangle": "0.1.0"},
    "probes": {"angle_deg": [0.0, 10.0], "temperature_c": [20.0, 20.0], "correction_arcsec": [0.0, 3.5]},
    "probe_tolerance_arcsec": 1e-6,
    "notes": [],
}


def test_the_document_survives_reading_and_writing() -> None:
    metadata = metadata_from_json(json.dumps(DOCUMENT), source="m")
    assert json.loads(metadata_to_json(metadata)) == DOCUMENT
    jsonschema.validate(DOCUMENT, metadata_schema())


def test_equal_models_give_equal_bytes() -> None:
    shuffled = dict(reversed(DOCUMENT.items()))
    first = metadata_to_json(metadata_from_json(json.dumps(DOCUMENT), source="m"))
    assert metadata_to_json(metadata_from_json(json.dumps(shuffled), source="m")) == first


@pytest.mark.parametrize(
    ("path", "value", "found"),
    [
        (("schema_version",), 2, "schema_version: expected a whole number, exactly 1, found 2"),
        (("sign_convention",), "corrected = raw - correction", "expected corrected = raw + correction"),
        (("inputs", 0, "unit"), "rad", "expected angle_deg in deg, then temperature_c in degC"),
        (("calibration", "file_sha256"), "abc", "64 hexadecimal digits"),
        (("calibration", "date"), "22.11.2026", "YYYY-MM-DD"),
        (("probes", "angle_deg"), [], "probe lists of one length"),
        (("encoder", "counts_per_rev"), 1, "counts_per_rev: expected a whole number, 2 to"),
        (("probe_tolerance_arcsec",), 1.0, "probe_tolerance_arcsec: expected a number, 0 to 1e-06"),
        (("extra",), 1, "unknown key extra"),
    ],
)
def test_dataclasses_and_schema_both_refuse(path: tuple[Any, ...], value: Any, found: str) -> None:
    document = copy.deepcopy(DOCUMENT)
    place: Any = document
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    with pytest.raises(ContractError) as caught:
        metadata_from_json(json.dumps(document), source="m")
    assert found in str(caught.value)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, metadata_schema())


def test_a_model_that_names_no_encoder_is_legal_and_says_so() -> None:
    document = {key: value for key, value in DOCUMENT.items() if key != "encoder"}
    metadata = metadata_from_json(json.dumps(document), source="m")
    jsonschema.validate(document, metadata_schema())
    assert metadata.encoder is None
    assert metadata.encoder_settings.known() == {}
    assert json.loads(metadata_to_json(metadata)) == document


def test_every_required_key_is_required_by_both() -> None:
    for key in metadata_schema()["required"]:
        document = {k: v for k, v in DOCUMENT.items() if k != key}
        with pytest.raises(ContractError, match=f"the key {key}"):
            metadata_from_json(json.dumps(document), source="m")


def test_nan_is_no_json() -> None:
    with pytest.raises(ContractError, match="NaN is no JSON number"):
        metadata_from_json(json.dumps(DOCUMENT | {"datum_deg": float("nan")}), source="m")


PROBES = Probes(angle_deg=(0.0, 10.0), temperature_c=(20.0, 20.0), correction_arcsec=(0.0, 3.5))


def test_a_probe_within_the_tolerance_agrees() -> None:
    assert (
        probe_disagreement(
            PROBES, correction_arcsec=[0.0, 3.5 + 5e-7], uncertainty_arcsec=None, tolerance_arcsec=1e-6
        )
        is None
    )


@pytest.mark.parametrize("value", [3.500002, float("nan"), float("inf")])
def test_a_probe_that_disagrees_is_named(value: float) -> None:
    text = probe_disagreement(
        PROBES, correction_arcsec=[0.0, value], uncertainty_arcsec=None, tolerance_arcsec=1e-6
    )
    assert text is not None
    assert "probe 2 (angle 10 deg, 20 degC): correction_arcsec expected 3.5" in text
