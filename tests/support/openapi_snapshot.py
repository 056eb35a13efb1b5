"""Write docs/openapi.json anew: `./dev openapi`.

Differences are printed. One that breaks clients is taken only if a line of README's Changes has the
word "breaking" and names it in backquotes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from openapi_diff import Difference, compare

from matiere.service.openapi import document_text

ROOT = Path(__file__).resolve().parents[2]
SNAPSHOT = ROOT / "docs" / "openapi.json"
REFRESH = "./dev openapi"


def differences(new: dict[str, Any]) -> list[Difference]:
    """Compare a document with the committed one."""
    return compare(json.loads(SNAPSHOT.read_text(encoding="utf-8")), new)


def untold(found: list[Difference], readme: str) -> list[Difference]:
    """Return the breaking differences that README's Changes do not tell."""
    entries = readme.split("\n## Changes\n")[1].split("\n## ")[0].split("\n- ")
    told = " ".join(entry for entry in entries if "breaking" in entry.lower())
    return [one for one in found if one.breaking and f"`{one.name}`" not in told]


def main() -> int:
    """Compare, then write or refuse."""
    text = document_text()
    if SNAPSHOT.exists():
        found = differences(json.loads(text))
        print("\n".join(map(str, found)) or "no difference")
        readme = (ROOT / "README.md").read_text(encoding="utf-8")
        if missing := untold(found, readme):
            print(
                "\nNot written: these break clients. Keep the old form working, or add to README's"
            )
            print('Changes a line with the word "breaking" that names each, in backquotes:')
            print("\n".join(f"  `{one.name}`" for one in missing))
            return 1
    SNAPSHOT.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
