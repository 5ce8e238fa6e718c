"""`make diagnosis-check`: draw, diagnose, score."""

import argparse
import json
import os
import sys
import time
from dataclasses import asdict, fields, replace
from pathlib import Path

ROOT = Path(__file__).parents[3]


def main(arguments: list[str]) -> int:
    """Exit code 1 where a case crashed the diagnosis, or the short form missed its bounds."""
    options = _options(arguments)
    # Before numpy is loaded, here and in each process of the pool: two threads each would fight over the cores.
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    sys.path[:0] = [str(ROOT / "training"), str(ROOT / "daemon"), str(ROOT)]
    from rich.console import Console
    from tests.benchmarks.diagnosis_check.case_set import SHORT, Sizes, wishes
    from tests.benchmarks.diagnosis_check.run import run
    from tests.benchmarks.diagnosis_check.short_form import missed
    from tests.benchmarks.diagnosis_check.summary import document, markdown

    sizes = SHORT if options.short else Sizes()
    given = {each.name: getattr(options, each.name) for each in fields(Sizes)}
    sizes = replace(sizes, **{name: value for name, value in given.items() if value is not None})
    wished = []
    for plan in ("paper", "rich") if options.plan == "both" else (options.plan,):
        share = options.rich_share if plan == "rich" and options.plan == "both" else 1.0
        wished += wishes(sizes.scaled(share) if share < 1.0 else sizes, plan=plan, seed=options.seed)
    wished = wished[: options.limit] if options.limit else wished
    started = time.monotonic()
    console = Console(stderr=True)
    records = run(
        wished,
        way=options.way,
        processes=options.processes,
        path=options.out / f"{options.way}.jsonl",
        console=console,
    )
    conditions = {"seed": options.seed, "way": options.way, "plan": options.plan, "sizes": asdict(sizes)}
    whole = document(records, conditions)
    (options.out / "summary.json").write_text(json.dumps(whole, indent=1) + "\n", "utf-8")
    text = markdown(whole)
    (options.out / "summary.md").write_text(text, "utf-8")
    print(text.split("## each effect")[0])
    print(
        f"{len(records)} cases, {time.monotonic() - started:.0f} s; the whole of it: {options.out / 'summary.md'}"
    )
    faults = missed(records) if options.short else []
    print(*faults, sep="\n")
    return 1 if whole["crashed"] or faults else 0


def _options(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="diagnosis_check", description=main.__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "diagnosis-check")
    parser.add_argument("--plan", choices=("paper", "rich", "both"), default="both")
    parser.add_argument("--way", choices=("attribution", "report", "command"), default="report")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--rich-share", type=float, default=0.25, help="part of the sizes on the rich plan beside both"
    )
    parser.add_argument("--limit", type=int, help="only the first cases")
    parser.add_argument("--short", action="store_true", help="a few cases with a fixed seed, bounds checked")
    for name in ("noise", "parametric", "single", "pair", "confounded", "unknown", "withheld", "broken"):
        parser.add_argument(f"--{name}", type=int, help="cases of this stratum")
    options = parser.parse_args(arguments)
    if options.short:
        options.plan = "paper"
        options.seed = 1
    return options


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
