"""Measure a clean build at -j2: total time, seconds and peak memory of every translation unit.

    ./dev bench build

The limits are those of the issue: 5 minutes in all, 90 s and 1.5 GB for one unit. Units are judged
by CPU seconds, which a busy machine does not stretch as it does wall time.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
JOBS = 2
MOST_BUILD_S = 300.0
MOST_UNIT_S = 90.0
MOST_UNIT_GB = 1.5
SHOWN = 10


def main() -> int:
    """Build in a folder of its own, print the table, return 1 if a limit is passed."""
    with tempfile.TemporaryDirectory() as folder:
        build = Path(folder)
        configure = ["cmake", "-S", str(ROOT), "-B", folder, "-G", "Ninja"]
        options = ["-DMATIERE_MEASURE=ON", f"-DPython_EXECUTABLE={sys.executable}"]
        quiet = subprocess.DEVNULL
        subprocess.run([*configure, *options], check=True, stdout=quiet)
        begun = time.monotonic()
        subprocess.run(["cmake", "--build", folder, "-j", str(JOBS)], check=True, stdout=quiet)
        total_s = time.monotonic() - begun
        lines = (build / "measure.tsv").read_text(encoding="utf-8").splitlines()
    units = []
    for line in lines:
        wall, cpu, kilobytes, name = line.split("\t")
        short = name.split(".dir/")[-1].removesuffix(".o")
        units.append((float(cpu), float(wall), int(kilobytes) / 2**20, short))
    units.sort(reverse=True)
    print(
        f"{len(units)} commands, {total_s:.0f} s at -j{JOBS},"
        f" {sum(unit[0] for unit in units):.0f} s of CPU"
    )
    print(f"{'CPU s':>7} {'wall s':>7} {'GiB':>6}  unit")
    for cpu_s, wall_s, gigabytes, name in units[:SHOWN]:
        print(f"{cpu_s:7.1f} {wall_s:7.1f} {gigabytes:6.2f}  {name}")
    slowest, largest = units[0][0], max(unit[2] for unit in units)
    kept = slowest <= MOST_UNIT_S and largest <= MOST_UNIT_GB
    print(f"slowest unit {slowest:.1f} s of CPU, largest {largest:.2f} GiB, total {total_s:.0f} s")
    return 0 if kept and total_s <= MOST_BUILD_S else 1


sys.exit(main())
