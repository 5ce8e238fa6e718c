"""The command `trueangle`: hands over to the laboratory, or says in one line what to install.

It stands in the daemon's package because it must also work where the laboratory's libraries are not installed.
"""

import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from typing import cast

LABORATORY = "trueangle_training.cli"
LIBRARIES = ("trueangle_training", "onnx", "rich", "torch")
"""Import names of what the extra `training` brings."""
EXIT_NOT_INSTALLED = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the laboratory's command line; the exit code."""
    missing = missing_libraries(LIBRARIES)
    if missing:
        sys.stderr.write(
            f"trueangle: the laboratory is not installed here ({', '.join(missing)} missing); "
            "install it with: pip install 'trueangle[training]'\n"
        )
        return EXIT_NOT_INSTALLED
    # One thread a process: on a busy machine OpenBLAS' threads wait for each other, which cost a factor of 30 in
    # small problems; and sums would depend on the number of cores. Read by the libraries when they are imported.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # ONNX Runtime's telemetry is a network client; it starts with the import unless told before.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    # By name: no module of the daemon may import the laboratory, and an import statement would draw torch into
    # whatever packages, scans or type checks the controller's install.
    laboratory = importlib.import_module(LABORATORY)
    run = cast("Callable[[Sequence[str] | None], int]", laboratory.main)
    return run(argv)


def missing_libraries(names: Sequence[str]) -> list[str]:
    """Those of the top-level packages that cannot be found; none of them is imported."""
    return [name for name in names if importlib.util.find_spec(name) is None]


if __name__ == "__main__":
    sys.exit(main())
