"""Compiler launcher: `measure.py LOG COMPILER ARGS...` appends one line per command to LOG.

The line is: wall seconds, CPU seconds, peak memory in KiB, object file; tab-separated.
"""

import os
import sys
import time
from pathlib import Path


def main() -> None:
    """Run the command, append its line, exit as it did."""
    log, command = sys.argv[1], sys.argv[2:]
    begun = time.monotonic()
    child = os.spawnvp(os.P_NOWAIT, command[0], command)
    _, status, usage = os.wait4(child, 0)
    named = "-o" in command[:-1]
    target = command[command.index("-o") + 1] if named else command[-1]
    cpu_s = usage.ru_utime + usage.ru_stime
    line = f"{time.monotonic() - begun:.2f}\t{cpu_s:.2f}\t{usage.ru_maxrss}\t{target}\n"
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(line)
    sys.exit(os.waitstatus_to_exitcode(status))


main()
