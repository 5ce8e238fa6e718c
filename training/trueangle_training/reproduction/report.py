"""The experiment as Markdown: tables beside the published ones, and what the text leaves open."""

import json
from collections.abc import Iterator

from trueangle_training.reproduction.experiment import Row
from trueangle_training.reproduction.summary import (
    PUBLISHED,
    PUBLISHED_RAW_RANGE,
    PUBLISHED_THERMAL_RANGE,
    ExperimentSummary,
    Mean,
    RowSummary,
)

TABLE_1 = (Row.UNTRAINED, Row.AS_PRINTED, Row.AFTER_LM, Row.HANDED_ON, Row.FE_BPNN, Row.BPNN)
TABLE_2 = (Row.POLY2D, Row.FEPF)
BASELINES = (Row.NONE, Row.ANGLE_ONLY, Row.HARMONICS_POLY)
FITNESS_TITLES = {
    "untrained": "fitness of the untrained weights",
    "after_lm": "fitness after 20 LM steps",
    "after_lm_handed_on": "fitness after 20 LM steps, trained weights handed on",
}
NOTES = (
    (
        "The readings behind the paper are not public. These are readings simulated from a joint whose five "
        "methods' residuals agree with the paper's; many other joints would do the same."
    ),
    (
        "All RMSEs of the tables are in-sample, as in the paper: residuals of the readings that were fitted, the "
        "tenth kept for validation included. They do not say which method is better at other angles and "
        "temperatures: `trueangle compare` does."
    ),
    (
        "The readings enter with nominal angles and set temperatures. LM: damping 1e-3, factors 0.1 and 10, at "
        "most 100 epochs (accepted steps), the best validation weights after 6 steps in a row without a better "
        "one. The paper says none of this."
    ),
    (
        "Eq. (7) rates an individual by the error of its own, untrained weights over all readings, those kept "
        "for validation included. The rows that rate individuals after 20 LM steps, and hand the trained weights "
        "on or not, are other readings of the text, chosen by us."
    ),
    (
        "Eq. (10) as printed lowers the parameter in both branches, surely a misprint. The rows use "
        "a + (a_max - a) f for r > 0.5 and a + (a_min - a) f else; one row shows the printed form."
    ),
    (
        "Eq. (6) scales the angle by its largest value, that of the last face (344.3 deg with 23 faces): from "
        "there to 360 deg the networks extrapolate, and nothing closes the turn."
    ),
    "The sizes of Fig. 8 and its values cannot be read from the text.",
)


def report_lines(summary: ExperimentSummary) -> Iterator[str]:
    """The document, line by line."""
    many = f"noise seeds {min(summary.seeds)} to {max(summary.seeds)}"
    yield "# The experiment of Jia et al. 2020 (Sensors 20, 2603) on a simulated joint"
    yield ""
    yield f"Means over {many} with their standard errors; {summary.trials} trials of each network a seed. Arcsec."
    for title, rows in (("Table 1", TABLE_1), ("Table 2", TABLE_2), ("Baselines, not in the paper", BASELINES)):
        yield ""
        yield f"## {title}"
        yield ""
        yield "| method | RMSE | published | off by | extremes | published |"
        yield "|---|---|---|---|---|---|"
        yield from (_row_line(each) for each in summary.rows if each.row in rows)
    yield from _figure_7_lines(summary)
    yield ""
    yield "## Figure 8: RMSE over hidden nodes"
    yield ""
    yield f"| nodes | {' | '.join(str(nodes) for nodes, _ in summary.figure_8)} |"
    yield "|---" * (len(summary.figure_8) + 1) + "|"
    yield f"| RMSE | {' | '.join(_shown(mean, 3) for _, mean in summary.figure_8)} |"
    yield from _gain_lines(summary)
    yield ""
    yield "## What to know"
    yield ""
    yield from (f"- {note}" for note in NOTES)


def figure_8_json(summary: ExperimentSummary) -> bytes:
    """Figure 8 as data, in arcsec; the standard errors are null where there is one noise seed."""
    document = {
        "format": 1,
        "figure": 8,
        "what": "in-sample RMSE over hidden nodes, fitness of the untrained weights, mean over noise seeds",
        "seeds": list(summary.seeds),
        "trials": summary.trials,
        "points": [
            {"hidden_nodes": nodes, "rmse": mean.value, "standard_error": mean.standard_error}
            for nodes, mean in summary.figure_8
        ],
    }
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()


def _row_line(each: RowSummary) -> str:
    extremes = f"{_shown(each.lowest, 1)} .. {_shown(each.highest, 1)}"
    published = PUBLISHED.get(each.row)
    if published is None or each.over_published is None:
        return f"| {each.row.value} | {_shown(each.rmse, 3)} | - | - | {extremes} | - |"
    off_percent = 100.0 * each.over_published
    return (
        f"| {each.row.value} | {_shown(each.rmse, 3)} | {published.rmse:.2f} | {off_percent:+.1f} % | "
        f"{extremes} | {published.lowest:.1f} .. {published.highest:.1f} |"
    )


def _figure_7_lines(summary: ExperimentSummary) -> Iterator[str]:
    yield ""
    yield "## Figure 7: mean error before compensation"
    yield ""
    yield "| | lowest | highest | published |"
    yield "|---|---|---|---|"
    for name, (low, high), published in (
        ("error", summary.raw_range, PUBLISHED_RAW_RANGE),
        ("change from 20 degC at one face", summary.thermal_range, PUBLISHED_THERMAL_RANGE),
    ):
        yield f"| {name} | {_shown(low, 1)} | {_shown(high, 1)} | {published[0]:.1f} .. {published[1]:.1f} |"


def _gain_lines(summary: ExperimentSummary) -> Iterator[str]:
    yield ""
    yield "## What the genetic algorithm contributes"
    yield ""
    yield (
        "In-sample RMSE with 30 individuals x 26 populations minus that of 780 random starts rated alike, the "
        "best one trained alike: equal computing, same split in each trial. Negative: the genetic algorithm is "
        "better."
    )
    yield ""
    yield "| fitness | difference | 95 % interval | seeds | trials |"
    yield "|---|---|---|---|---|"
    for name, gain in summary.gains.items():
        known = gain.low is not None and gain.high is not None
        interval = f"{gain.low:+.4f} .. {gain.high:+.4f}" if known else "-"
        title = FITNESS_TITLES[name]
        yield f"| {title} | {gain.difference:+.4f} | {interval} | {gain.seeds} | {gain.trials} |"


def _shown(mean: Mean, digits: int) -> str:
    error = "" if mean.standard_error is None else f" ± {mean.standard_error:.{digits}f}"
    return f"{mean.value:.{digits}f}{error}"
