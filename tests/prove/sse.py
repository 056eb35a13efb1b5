"""Events: 200 listeners, the service killed 10 times: no gap, no repeat, rising numbers

Listeners of all events, of a sweep and of single jobs follow a real `matiere serve` (with the
stand-in renderer of tests/jobs), which gets a sweep and a SIGKILL every second or so; each connects
again with its Last-Event-ID. At the end each must have received exactly the events that the
history holds after its snapshot. The result is stored in prove-out/sse.json.
"""

import asyncio
import json
import shutil
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "service"), str(HERE.parent / "support")]

from _service import OUT  # noqa: E402
from sse_clients import faults, tally  # noqa: E402
from test_events import follow  # noqa: E402

CLIENTS, KILLS = 200, 10


def main() -> None:
    """Run, print and store."""
    data = OUT / "sse"
    shutil.rmtree(data, ignore_errors=True)
    begin = time.monotonic()
    listeners, expected = asyncio.run(follow(data, CLIENTS, KILLS))
    tallies = [tally(one, expected[one.address]) for one in listeners]
    faulty = sum(bool(faults(one, expected[one.address])) for one in listeners)
    result = {
        "clients": CLIENTS,
        "kills": KILLS,
        "seconds": round(time.monotonic() - begin, 1),
        "events_received": sum(len(one.numbers) for one in listeners),
        "connections": sum(one.connections for one in listeners),
        "events_of_the_history": len(expected["/v1/events"]),
        "gaps": sum(gaps for gaps, _, _ in tallies),
        "repeats": sum(repeats for _, repeats, _ in tallies),
        "falling_numbers": sum(falls for _, _, falls in tallies),
        "listeners_with_any_fault": faulty,
    }
    OUT.mkdir(exist_ok=True)
    (OUT / "sse.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))
    if faulty or result["events_of_the_history"] < 50 * KILLS:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
