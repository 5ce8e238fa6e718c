"""The methods of a compare.json, as far as the report shows them; what is not known is passed over."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from trueangle.contract.errors import ContractError, Fault
from trueangle_training.hidden_node_sweep import FEWEST_POINTS, HiddenNodeSweep, SweepPoint

FORMAT = 1
AT_TEMPERATURE = "leave-one-temperature-out"


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedMethod:
    """One method, in arcsec; None: not in the file."""

    name: str
    in_sample_rmse: float | None
    left_out_rmse: float | None
    """At left-out temperatures."""
    low: float | None = None
    """95 % interval of it."""
    high: float | None = None
    largest: float | None = None
    coverage_2u: float | None = None
    """Share within 2 u, 0 to 1."""
    over_oracle: float | None = None
    true_rmse: float | None = None
    seconds: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedMethods:
    """A comparison and the campaign it was made on."""

    source: str
    campaign_sha256: str
    simulated: bool
    methods: tuple[ComparedMethod, ...]
    """In the file's order: best first."""
    sweeps: tuple[HiddenNodeSweep, ...] = ()
    """Those that can be shown."""

    def sweep(self, method: str) -> HiddenNodeSweep | None:
        """The hidden-node sweep of one method; None: the file has none."""
        return next((sweep for sweep in self.sweeps if sweep.method == method), None)


def read_comparison(data: bytes, *, source: str) -> ComparedMethods:
    """Parse a compare.json; ContractError where it is none."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ContractError([Fault(where=source, expected="a JSON document", found=str(error))]) from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        found = f"format {document.get('format')!r}" if isinstance(document, dict) else type(document).__name__
        raise ContractError([Fault(where=source, expected=f"a compare.json of format {FORMAT}", found=found)])
    methods = document.get("methods")
    if not isinstance(methods, list) or not all(isinstance(each, dict) and "name" in each for each in methods):
        raise ContractError([Fault(where=f"{source}, methods", expected="a list of methods", found="none")])
    calibration = _mapping(document.get("calibration"))
    return ComparedMethods(
        source=source,
        campaign_sha256=str(calibration.get("sha256", "")),
        simulated=bool(document.get("simulated", False)),
        methods=tuple(_method(each) for each in methods),
        sweeps=tuple(
            sweep
            for name, entry in _mapping(document.get("hidden_nodes")).items()
            if (sweep := _sweep(name, _mapping(entry))) is not None
        ),
    )


def _sweep(method: str, entry: Mapping[str, object]) -> HiddenNodeSweep | None:
    """None: less than two points with all their figures."""
    points: list[SweepPoint] = []
    for each in map(_mapping, _listed(entry.get("points"))):
        nodes, rmse = _number(each.get("hidden_nodes")), _number(each.get("rmse"))
        error = _number(each.get("standard_error"))
        at_temperature = [_number(value) for value in _listed(each.get("at_temperature"))]
        if nodes is None or rmse is None or error is None:
            return None
        points.append(
            SweepPoint(
                hidden_nodes=int(nodes),
                rmse_arcsec=rmse,
                standard_error_arcsec=error,
                at_temperature_arcsec=tuple(value for value in at_temperature if value is not None),
            )
        )
    if len(points) < FEWEST_POINTS:
        return None
    return HiddenNodeSweep(
        method=method,
        setting=str(entry.get("setting", "")),
        temperatures=tuple(str(label) for label in _listed(entry.get("temperatures"))),
        points=tuple(sorted(points, key=lambda point: point.hidden_nodes)),
    )


def _listed(value: object) -> list[object]:
    return cast("list[object]", value) if isinstance(value, list) else []


def _method(entry: Mapping[str, object]) -> ComparedMethod:
    held_out = _mapping(_mapping(entry.get("held_out")).get(AT_TEMPERATURE))
    truth = _mapping(entry.get("truth"))
    return ComparedMethod(
        name=str(entry["name"]),
        in_sample_rmse=_number(entry.get("in_sample_rmse")),
        left_out_rmse=_number(held_out.get("rmse")),
        low=_number(held_out.get("low")),
        high=_number(held_out.get("high")),
        largest=_number(held_out.get("largest")),
        coverage_2u=_number(held_out.get("coverage_2u")),
        over_oracle=_number(truth.get("over_oracle")),
        true_rmse=_number(truth.get("rmse")),
        seconds=_number(entry.get("seconds")),
    )


def _mapping(value: object) -> Mapping[str, object]:
    return cast("Mapping[str, object]", value) if isinstance(value, dict) else {}


def _number(value: object) -> float | None:
    known = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return float(cast("float", value)) if known else None
