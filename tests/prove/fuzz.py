"""HTTP: 10,000 cases of Schemathesis, renders paused: no 5xx, problems only, no read outside

Runs in parts of 1,000 cases, each a service and a seed of its own; finished parts are kept below
prove-out/fuzz and not run again. `--cases N` asks for another number.
"""

import argparse
import json
import shutil
import sys
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "service"), str(HERE.parent / "support")]

import api_fuzz  # noqa: E402

OUT = HERE.parents[1] / "prove-out"
PART = 1000


def part(number: int, folder: Path) -> dict[str, object]:
    """Run one part, or return what it gave before."""
    stored = folder / f"part-{number}.json"
    if stored.exists():
        return dict(json.loads(stored.read_text()))
    scratch = folder / f"part-{number}"
    shutil.rmtree(scratch, ignore_errors=True)
    result = api_fuzz.fuzz(scratch, PART, start=number + 1)
    found = {
        "seed": number + 1,
        "answers": [[route, status, n] for (route, status), n in sorted(result.answers.items())],
        "growth_bytes": result.growth(),
        "faults": result.faults,
        "outside": sorted(set(result.outside)),
        "opened": result.opened,
        "processes": result.processes,
    }
    shutil.rmtree(scratch)
    stored.write_text(json.dumps(found, indent=1) + "\n")
    return found


def main() -> int:
    """Run, print and store."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=10_000)
    wanted = parser.parse_args().cases
    folder = OUT / "fuzz"
    folder.mkdir(parents=True, exist_ok=True)
    whole = api_fuzz.Result(answers=Counter(), rss_bytes=[0])
    number = 0
    while whole.cases < wanted:
        found = part(number, folder)
        for route, status, n in found["answers"]:
            whole.answers[route, status] += n
        whole.faults += found["faults"]
        whole.outside += found["outside"]
        whole.rss_bytes.append(found["growth_bytes"])
        whole.opened += found["opened"]
        whole.processes += found["processes"]
        number += 1
        print(f"part {number}: {whole.cases} cases, {len(whole.faults)} faults", flush=True)
    print(whole.table())
    (folder / "table.txt").write_text(whole.table() + "\n")
    for fault in whole.faults[:20]:
        print(fault)
    right = (
        not whole.faults
        and not whole.outside
        and whole.share() >= api_fuzz.ACCEPTED_SHARE
        and whole.growth() < api_fuzz.GROWTH_BYTES
    )
    print("passed" if right else "FAILED")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
