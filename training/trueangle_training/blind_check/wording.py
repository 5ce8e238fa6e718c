"""The result on a terminal."""

from typing import Any

Json = dict[str, Any]

NAME_WIDTH = 62


def summary_lines(result: Json) -> list[str]:
    """Every figure in a line, then whether the files leak, how often the set was seen, and what crashed."""
    head = f"{'figure':<{NAME_WIDTH}}{'found':>8}  {'95 %':<15}{'cases':>11}   must              ambitious"
    lines = ["", head, *(_figure_line(row) for row in result["figures"]), ""]
    lines += [*_canary_lines(result["canary"]), _seen_line(result)]
    if result["not_asked"]:
        lines.append(f"{'not asked':<17}{', '.join(result['not_asked'])}: hidden by the plan (--plan both)")
    if result["diagnosis_changed"]:
        lines.append(
            f"{'changed':<17}the diagnosis' sources, while it was asked: not every answer is of one state"
        )
    if result["crashed"]:
        lines.append(
            f"{'crashed':<17}{len(result['crashed'])} cases, the first: {result['crashed'][0]['case_id']}"
        )
    missed = [row["name"] for row in result["figures"] if row["must_is"] == "missed" and not row["beside"]]
    lines.append(f"{'missed':<17}{'; '.join(missed) or 'no bound of the must column for certain'}")
    return lines


def _figure_line(row: Json) -> str:
    if row["value"] is None:
        return f"{row['name']:<{NAME_WIDTH}}{'-':>8}"
    interval = "-" if row["low"] is None else f"{row['low']:.3f} - {row['high']:.3f}"
    cases = str(row["cases"]) if row["hits"] is None else f"{row['hits']} of {row['cases']}"
    sign = "<=" if row["at_most"] else ">="
    must = f"{sign} {row['must']:g} {row['must_is']}"
    return (
        f"{row['name']:<{NAME_WIDTH}}{row['value']:>8.3f}  {interval:<15}{cases:>11}   {must:<18}"
        f"{sign} {row['ambitious']:g} {row['ambitious_is']}"
    )


def _canary_lines(canary: Json) -> list[str]:
    lines: list[str] = []
    for each in canary["songs"]:
        if each["group"] not in ("all", "errors") and not each["leaks"]:
            continue
        what = f"{each['task']}, from {'the errors (control)' if each['control'] else each['group']}"
        if each["area"] is None:
            lines.append(f"{'leak canary':<17}{what}: too few cases")
            continue
        word = ("tells, as it must" if each["p_value"] < 0.05 else "silent") if each["control"] else "at chance"
        lines.append(
            f"{'leak canary':<17}{what}: area {each['area']:.3f}, shuffled labels {each['shuffled_area']:.3f}, "
            f"p {each['p_value']:.3f}: {'LEAK' if each['leaks'] else word}"
        )
    shuffled = canary["shuffled"]
    if shuffled["right"] is None:
        return [*lines, f"{'shuffled truths':<17}too few cases"]
    word = "at chance" if shuffled["at_chance"] else "NOT AT CHANCE: the scorer rewards wrong answers"
    lines.append(
        f"{'shuffled truths':<17}{shuffled['shuffled']:.3f} right, chance {shuffled['chance']:.3f}, "
        f"in truth {shuffled['right']:.3f}: {word}"
    )
    return lines


def _seen_line(result: Json) -> str:
    seen = result["seen"]
    if not seen["logged"]:
        return f"{'seen before':<17}nobody keeps count (--log FILE)"
    if seen["same_diagnosis"]:
        return f"{'seen before':<17}by this very diagnosis; by {seen['before']} other states of it"
    times = f"by {seen['before']} earlier states of the diagnosis: no longer a blind set"
    return f"{'seen before':<17}{times if seen['before'] else 'never'}"
