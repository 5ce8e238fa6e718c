"""Do the files give the truth away without their errors, and does the scorer reward answers to other questions?

A classifier is given what of a case has nothing to do with what is wrong in it: how many rows, what was left
empty, how numbers are written, how the campaign was carried out, what JOINT.yaml lists. It must be at chance in
telling sound joints from those that lack something, and effects of the library from others.

What an effect itself moves is signal and left out: the errors, the indicated angle (latency, lost and coarse
counts move it), the width of printed numbers (large errors have more digits). Cases of a wrong temperature sensor
and broken files are left out, for they move columns by their nature. As a control the same classifier is given
the errors' scatter and shape, where it must not be at chance: a canary that cannot sing says nothing.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

Floats = NDArray[np.float64]

PERMUTATIONS = 999
FOLDS = 5
RIDGE = 3.0
LEAK_BELOW = 0.01
"""p value of a leak: five looks at four tasks each would otherwise often cry wolf."""
LEAST = 12
"""Cases of the rarer label below which nothing is judged."""
CONTROL = "errors"
GROUPS = ("file", "plan", "joint")
"""What must not tell; the control beside them must."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traits:
    """What is seen of one case without its truth, by group."""

    file: dict[str, float]
    plan: dict[str, float]
    joint: dict[str, float]
    errors: dict[str, float]

    def of(self, group: str) -> dict[str, float]:
        """One group, or `all` but the control."""
        if group == "all":
            return self.file | self.plan | self.joint
        return {"file": self.file, "plan": self.plan, "joint": self.joint, CONTROL: self.errors}[group]


@dataclass(frozen=True, slots=True, kw_only=True)
class Song:
    """What the classifier made of one task with one group of traits."""

    task: str
    group: str
    cases: int
    area: float | None
    """Under the ROC curve, held-out folds, pairs of the same plan and plant only; None: too few cases."""
    shuffled_area: float | None
    """Mean over shuffled labels."""
    p_value: float | None
    """Share of shuffled labels that did at least as well."""

    @property
    def leaks(self) -> bool:
        """It tells more than chance would; of the control that is as it should be."""
        return self.p_value is not None and self.p_value < LEAK_BELOW


def traits_of(measured_csv: str, joint_yaml: str) -> Traits:
    """Counted from the texts as they are."""
    lines = measured_csv.splitlines()
    names = lines[0].split(",")
    cells = [line.split(",") for line in lines[1:]]
    empty = np.mean([[not cell for cell in row] for row in cells], axis=0)
    column = {name: np.array([float(row[i] or "nan") for row in cells]) for i, name in enumerate(names)}
    time, temperature = column["time_s"], column["temperature_c"]
    steps = np.diff(time)
    within = steps[np.diff(column["run"]) == 0]
    error = column["error_arcsec"][np.isfinite(column["error_arcsec"])]
    decimals = [_decimals(row[i] for row in cells) for i in range(len(names))]
    numbers = re.findall(r"amplitude_arcsec(?:_per_k)?: ([0-9.]+)", joint_yaml)
    return Traits(
        file={
            "rows": float(len(cells)),
            "columns": float(len(names)),
            **{f"empty {name}": float(share) for name, share in zip(names, empty, strict=True)},
            **{f"decimals {name}": count for name, count in zip(names, decimals, strict=True)},
        },
        plan={
            "hours": float(np.log(np.ptp(time) / 3600.0)),
            "rhythm": float(np.log(np.median(within))),
            "unevenness": float(np.log(np.percentile(within, 90) / np.median(within))),
            "longest pause": float(np.log(steps.max())),
            "first time": float(time[0]),
            "runs": float(np.unique(column["run"]).size),
            "coldest": float(np.nanmin(temperature)),
            "warmest": float(np.nanmax(temperature)),
            "mean temperature": float(np.nanmean(temperature)),
            "trend of temperature": float(np.corrcoef(time, np.nan_to_num(temperature, nan=20.0))[0, 1]),
            "steadiness": _steadiness(temperature, column["run"]),
            "load": float(np.mean(column["load_nm"])),
            "loads": float(np.ptp(column["load_nm"])),
            "speed": float(np.abs(column["velocity_deg_s"]).max()),
            "offset": float(column["polygon_offset"].mean()),
        },
        joint={
            **_settings(joint_yaml),
            "lines": float(joint_yaml.count("\n")),
            "effects": float(len(re.findall(r"^  \w+:", joint_yaml, flags=re.MULTILINE))),
            "amplitudes": float(len(numbers)),
            "amplitude": float(np.log1p(np.mean([float(each) for each in numbers]))) if numbers else 0.0,
        },
        errors={
            "scatter": float(np.log(np.std(error) + 1e-6)),
            "roughness": float(np.log(np.std(np.diff(error)) + 1e-6)),
            "tails": float(np.log(np.mean((error - error.mean()) ** 4) + 1e-12)),
        },
    )


def _decimals(texts: Iterable[str]) -> float:
    return float(max((len(text.partition(".")[2]) for text in texts), default=0))


def _steadiness(temperature_c: Floats, run: Floats) -> float:
    """log of how far the sensor wanders inside a run, in the middle of all runs."""
    ranges = [np.ptp(values) for each in np.unique(run) if (values := temperature_c[run == each]).size > 1]
    return float(np.log(np.nanmedian(ranges) + 1e-3)) if ranges else 0.0


def _settings(joint_yaml: str) -> dict[str, float]:
    """The numbers of the file's head; 0 where one is left out."""
    found: dict[str, float] = {}
    for name in ("lines_per_rev", "counts_per_rev", "repeatability_arcsec", "resolution_c"):
        match = re.search(rf"{name}: ([0-9.]+)", joint_yaml)
        found[name] = float(np.log(float(match[1]))) if match else 0.0
    return found


def song(
    task: str, group: str, traits: Sequence[Traits], label: NDArray[np.bool_], stratum: NDArray[np.int64]
) -> Song:
    """How well a linear discriminant tells the labels from the traits, against labels shuffled inside strata.

    `label` and `stratum` [cases]; a stratum is one plan of one plant, whose traits differ for honest reasons.
    """
    usable = np.isin(stratum, [s for s in np.unique(stratum) if 0 < label[stratum == s].mean() < 1])
    label, stratum = label[usable], stratum[usable]
    rare = int(min(label.sum(), (~label).sum())) if label.size else 0
    if rare < LEAST:
        return Song(task=task, group=group, cases=int(label.size), area=None, shuffled_area=None, p_value=None)
    rows = [trait.of(group) for trait, used in zip(traits, usable, strict=True) if used]
    shape = _standardised(np.array([list(row.values()) for row in rows]), stratum)
    rng = np.random.default_rng(0)
    labels = np.column_stack([label, *(_shuffled(label, stratum, rng) for _ in range(PERMUTATIONS))])
    areas = _areas(_held_out(shape, labels.astype(np.float64), stratum, rng), labels, stratum)
    return Song(
        task=task,
        group=group,
        cases=int(label.size),
        area=float(areas[0]),
        shuffled_area=float(areas[1:].mean()),
        p_value=float((1 + np.sum(areas[1:] >= areas[0])) / (1 + PERMUTATIONS)),
    )


def _standardised(values: Floats, stratum: NDArray[np.int64]) -> Floats:
    """Traits and their squares, mean 0 in each stratum, spread 1; a trait that never differs is left out."""
    centred = _centred(values, stratum)
    spread = centred.std(axis=0)
    kept = spread > 1e-9 * np.maximum(np.abs(values).max(axis=0), 1.0)
    scaled = centred[:, kept] / spread[kept]
    squares = _centred(scaled**2, stratum)
    return np.column_stack([scaled, squares / np.maximum(squares.std(axis=0), 1e-9)])


def _centred(values: Floats, stratum: NDArray[np.int64]) -> Floats:
    out = values.copy()
    for each in np.unique(stratum):
        out[stratum == each] -= out[stratum == each].mean(axis=0)
    return out


def _shuffled(label: NDArray[np.bool_], stratum: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.bool_]:
    out = label.copy()
    for each in np.unique(stratum):
        rows = np.flatnonzero(stratum == each)
        out[rows] = label[rng.permutation(rows)]
    return out


def _held_out(shape: Floats, labels: Floats, stratum: NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """[cases, labellings]: what ridge regression on the other folds says; labels centred in each stratum."""
    centred = _centred(labels, stratum)
    fold, said = rng.permutation(shape.shape[0]) % FOLDS, np.zeros_like(labels)
    for each in range(FOLDS):
        out, inside = fold == each, fold != each
        gram = shape[inside].T @ shape[inside] + RIDGE * np.eye(shape.shape[1])
        said[out] = shape[out] @ np.linalg.solve(gram, shape[inside].T @ centred[inside])
    return said


def _areas(said: Floats, labels: NDArray[np.bool_], stratum: NDArray[np.int64]) -> Floats:
    """Mann and Whitney's share of pairs in the right order, pairs of one stratum, shape [labellings]."""
    right, pairs = np.zeros(said.shape[1]), 0.0
    for each in np.unique(stratum):
        rows = stratum == each
        ranks = rankdata(said[rows], axis=0)
        ones = float(labels[rows, 0].sum())
        zeros = float(rows.sum()) - ones
        right += np.sum(ranks * labels[rows], axis=0) - ones * (ones + 1.0) / 2.0
        pairs += ones * zeros
    return right / pairs


TASKS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "sound or not": (("noise", "parametric"), ("single", "pair", "confounded", "unknown", "withheld")),
    "in the library or not": (("single", "pair"), ("unknown",)),
}


def songs(cases: Sequence[tuple[str, str, str]], traits_at: Callable[[int], Traits]) -> list[Song]:
    """All tasks with all groups; a case is its stratum, its plan with its plant, and its effects as one text.

    Raises nothing on few cases: what cannot be judged says so.
    """
    places = {name: number for number, name in enumerate(dict.fromkeys(plan for _, plan, _ in cases))}
    found: list[Song] = []
    known: dict[int, Traits] = {}
    for task, (no, yes) in TASKS.items():
        chosen = [
            i
            for i, (stratum, _, effects) in enumerate(cases)
            if stratum in (*no, *yes) and "temperature_sensor_error" not in effects
        ]
        for i in chosen:
            if i not in known:
                known[i] = traits_at(i)
        label = np.array([cases[i][0] in yes for i in chosen], dtype=np.bool_)
        stratum = np.array([places[cases[i][1]] for i in chosen], dtype=np.int64)
        traits = [known[i] for i in chosen]
        found += [song(task, group, traits, label, stratum) for group in ("all", *GROUPS, CONTROL)]
    return found
