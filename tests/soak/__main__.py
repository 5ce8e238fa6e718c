"""`SOAK_S=3600 python -m tests.soak`: memory and descriptors of a daemon under mixed load; exit 1: they rise."""

import asyncio
import os
import random
import sys
import tempfile
from pathlib import Path

from tests.soak.load import CLIENTS, JOINTS, soak


def main() -> int:
    seconds = float(os.environ.get("SOAK_S", "3600"))
    with tempfile.TemporaryDirectory() as folder:
        account = asyncio.run(soak(seconds, Path(folder), random.Random(1)))
    warm = account.memory.warm
    print(f"soak of {seconds:g} s: {JOINTS} joints, {CLIENTS} clients that read on, {account.reads} reads")
    print(f"{account.visits} clients came and went, {account.reloads} reloads, {account.reboots} node reboots")
    print(f"share of joints served as good: {account.valid / max(1, JOINTS * account.reads):.3f}")
    print(f"resident MiB: {warm[0][1]:.1f} at 10 %, {warm[-1][1]:.1f} at the end")
    print(f"the line through all readings between rises by {account.memory.rise_mib:.2f} MiB")
    tenths = warm[:: max(1, len(warm) // 10)]
    print("resident MiB along the way: " + " ".join(f"{mib:.1f}" for _, mib in tenths))
    print(f"file descriptors: {account.descriptors_begin} at 10 %, {account.descriptors_end} at the end")
    rises = account.memory.rises or account.descriptors_end > account.descriptors_begin
    print("RISES" if rises else "flat within noise")
    return int(rises)


if __name__ == "__main__":
    sys.exit(main())
