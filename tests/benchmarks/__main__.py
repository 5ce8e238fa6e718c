"""`make bench`: every benchmark of this folder one after the other, with the machine's load before each."""

import os
import subprocess
import sys
from pathlib import Path

LONG = ("estimators", "genetic_start")
"""Take minutes to an hour: run only when named, as in `python -m tests.benchmarks estimators`."""
FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]


def main() -> int:
    """Run them all, or those named on the command line; the number that failed."""
    chosen = sys.argv[1:]
    failed = 0
    for script in sorted(FOLDER.glob("bench_*.py")):
        name = script.stem.removeprefix("bench_")
        if chosen and name not in chosen:
            continue
        if not chosen and name in LONG:
            print(f"\n== {script.stem} left out; run it by name: python -m tests.benchmarks {name}", flush=True)
            continue
        load = " ".join(f"{value:.2f}" for value in os.getloadavg())
        print(f"\n== {script.stem}   ({os.cpu_count()} cores, load {load})", flush=True)
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = os.pathsep.join(str(ROOT / name) for name in ("daemon", "training", "."))
        done = subprocess.run([sys.executable, str(script)], check=False, env=environment, cwd=ROOT)
        failed += done.returncode != 0
    return failed


if __name__ == "__main__":
    sys.exit(main())
