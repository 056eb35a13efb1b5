"""A thousand cases of Schemathesis: no 5xx, problems only, no read outside, no growth."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import api_fuzz
import pytest

pytest.importorskip("matiere._core", reason="needs the built core")


@pytest.mark.slow
def test_no_case_of_schemathesis_breaks_the_service(tmp_path: Path) -> None:
    result = api_fuzz.fuzz(tmp_path, cases=1000)
    print(result.table())
    assert not result.faults, "\n".join(result.faults[:10])
    assert result.cases >= 1000
    assert result.share() >= api_fuzz.ACCEPTED_SHARE
    assert not result.outside, result.outside[:20]
    assert result.opened > 100 and result.processes >= 3  # the service and both of its children
    assert result.growth() < api_fuzz.GROWTH_BYTES


def test_a_read_outside_the_roots_is_seen(tmp_path: Path) -> None:
    """The recorder notices what the fuzzer relies on it to notice."""
    for name in ("opens", "site", "data"):
        (tmp_path / name).mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(api_fuzz.RECORDER)
    (tmp_path / "secret").write_text("x")
    (tmp_path / "data" / "link").symlink_to(tmp_path / "secret")
    code = f"open({str(tmp_path / 'data' / 'link')!r}).read()"
    environ = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    environ["FUZZ_OPENS"] = str(tmp_path / "opens")
    subprocess.run([sys.executable, "-c", code], env=environ, check=True, timeout=60)
    result = api_fuzz.Result()
    api_fuzz.read_opens(tmp_path, result)
    assert result.outside == [os.path.realpath(tmp_path / "secret")]
