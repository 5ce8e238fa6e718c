"""The demo as a whole process: time from the command to the summary, training of six joints included."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main() -> None:
    """Run it once with its default options and print what it reached."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "demo"
        started_s = time.monotonic()
        command = [sys.executable, "-m", "trueangle.laboratory", "demo", "--out", str(out)]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        elapsed_s = time.monotonic() - started_s
        print(
            f"trueangle demo: exit code {done.returncode}, {elapsed_s:.1f} s in all (figure to reach: under 60 s)"
        )
        if done.returncode != 0:
            print(done.stdout[-2000:] + done.stderr[-2000:])
            sys.exit(1)
        summary = json.loads((out / "summary.json").read_text("utf-8"))
        for key, value in summary.items():
            if key != "per_joint":
                print(f"  {key}: {value}")


if __name__ == "__main__":
    main()
