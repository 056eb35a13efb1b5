"""Issue 3, acceptance 1: one table, every model against its whole contract, in float and in double

Runs the contract tests of tests/material over every parameter set they know and every cell of
examples/materials, and measures each with the stability report. Resumable: prove-out/materials.json
keeps a row per parameter set and build; prove-out/materials.md is the table. Arguments: names of
models (all); --sample N takes N parameter sets of each model; --oracle prints only the worst
comparison of every model with its 50-digit oracle (acceptance 2).
"""

import argparse
import importlib.util
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "support")]

import pytest  # noqa: E402
from material_cases import ROWS, Case, all_cases  # noqa: E402

import matiere as mt  # noqa: E402
from matiere.jobs import sweep as sweeps  # noqa: E402
from matiere.probe import validated  # noqa: E402
from matiere.scene.flatten import core_params  # noqa: E402
from matiere.stability.estimates import is_estimate  # noqa: E402
from matiere.stability.report import Promises, check_bsdf  # noqa: E402
from matiere.stability.views import TRANSMISSION  # noqa: E402

OUT = ROOT / "prove-out"
PRECISIONS = ("float", "double")
# column -> the contract test that decides it
TESTS = {
    "chi2, pdf": "test_samples_follow_the_pdf",
    "weight": "test_the_weight_is_eval_over_pdf",
    "reciprocity": "test_scattering_is_reciprocal",
    "furnace": "test_the_furnace_never_gains",
    "finite": "test_nothing_is_ever_non_finite_or_negative",
    "sides": "test_sampled_directions_are_unit_and_on_the_lobes_side",
}
# column -> key of a view of the stability report, and which of two values is worse
MEASURES: dict[str, tuple[str, Callable[..., float]]] = {
    "smallest p": ("chi_square_p", min),
    "pdf gap": ("pdf_gap", max),
    "weight gap": ("weight_gap", max),
    "reciprocity gap": ("reciprocity_gap", max),
    "largest albedo": ("albedo", max),
    "float gap": ("float_gap", max),
}


def tests_of(name: str) -> Any:
    """Return a module of tests/material."""
    path = ROOT / "tests" / "material" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def examples() -> Iterator[Case]:
    """Yield the materials of every cell of examples/materials that a probe can take."""
    base = {"materials": {"ball": {"type": "lambert"}}}
    for path in sorted((ROOT / "examples" / "materials").glob("*.json")):
        sweep = json.loads(path.read_text(encoding="utf-8"))
        try:
            axes = sweeps.parse_axes(sweep["axes"], base, sweep.get("mode", "grid"))
            cells = list(sweeps.expand(base, axes, sweep.get("mode", "grid")))
        except mt.MatiereError:
            continue  # varies more than the material
        for cell in cells:
            material = dict(cell.scene["materials"]["ball"])
            try:
                params = core_params(validated(material), {})
            except (mt.MatiereError, KeyError):
                continue  # has textures or names a file; `all_cases` makes files of its own
            yield Case(material["type"], params)


def walks() -> Iterator[Case]:
    """Yield the random walks: estimates, which the contract tests leave to tests of their own."""
    for name, params in tests_of("test_layered").WALKS.items():
        yield Case("layered", {"method": "walk", **params}, f"walk-{name}")


def judge(case: Case) -> dict[str, Any]:
    """Run every contract test on one parameter set in both precisions, and measure it."""
    module = tests_of("test_contract")
    double, single = case.bsdf("double"), case.bsdf("float")
    estimate = is_estimate(double)
    row: dict[str, Any] = {"type": case.type, "id": case.id, "faults": {}}
    for precision in PRECISIONS:
        verdicts: dict[str, bool | None] = {}
        for column, name in TESTS.items():
            try:
                if estimate:
                    pytest.skip("an estimate is judged by its means")
                getattr(module, name)(case, precision)
                verdicts[column] = True
            except pytest.skip.Exception:
                verdicts[column] = None  # not promised
            except AssertionError as error:
                verdicts[column] = False
                row["faults"][f"{column}, {precision}"] = str(error)[:400]
        row[precision] = verdicts
    promises = Promises(case.reciprocal, bool(double.lobes & TRANSMISSION))
    report = check_bsdf(double, single, promises)
    views = [view | derived(view) for view in report.views]
    for column, (key, worse) in MEASURES.items():
        known = [view[key] for view in views if view[key] is not None]
        row[column] = worse(known, default=None)
    # The estimates (random walks) have a column of their own: E[eval] against sampled weights,
    # E[reciprocity] and furnace, as the stability report judges them.
    row["estimate"] = report.verdict if estimate else None
    if row["estimate"] == "fail":
        row["faults"]["estimate"] = report.reason
    row["report"] = report.verdict
    row["reason"] = report.reason
    return row


def derived(view: dict[str, Any]) -> dict[str, float | None]:
    """Return what a view says only in parts."""
    parts = [view["pdf_integral"], view["rejected"], view["delta"]]
    gap = None if None in parts else abs(sum(parts) - 1)
    return {"pdf_gap": gap, "albedo": max(view["albedo"])}


def oracle_worst(log: Path) -> dict[str, dict[str, Any]]:
    """Run the tests that compare with an oracle; return model -> worst error and share of allowed.

    Errors are relative, and allowed is max(1e-5, 8 roundings of the inputs): see oracle.allowance.
    """
    files = [
        str(path)
        for folder in ("material", "optics")
        for path in sorted((ROOT / "tests" / folder).glob("test_*.py"))
        if re.search(r"^(import|from) oracle", path.read_text(encoding="utf-8"), re.M)
    ]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "oracle_log"]
    words = ["-k", "oracle or digits or quadrature or definition"]
    paths = [str(ROOT / "tests" / "support"), os.environ.get("PYTHONPATH", "")]
    environment = {"MATIERE_ORACLE_LOG": str(log), "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [*command, *words, *files], cwd=ROOT, env={**os.environ, **environment}, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    print(done.stdout.splitlines()[-1] if done.stdout else done.stderr)
    if done.returncode:
        sys.exit(f"{done.stdout}\na model leaves its oracle by more than is allowed")
    found: dict[str, dict[str, Any]] = json.loads(log.read_text(encoding="utf-8"))
    return found


def oracle_table(found: dict[str, dict[str, Any]]) -> str:
    """Return the worst comparison of every model, and of the parts of optics, as markdown."""
    head = "| what | comparisons | worst error | worst share of what is allowed | where |"
    lines = [head, "|" + "---|" * 5]
    for name, worst in found.items():
        numbers = f"{worst['checks']} | {worst['error']:.1e} | {worst['share']:.2f}"
        lines.append(f"| {name} | {numbers} | {worst['case']} |")
    return "\n".join(lines)


def table(rows: list[dict[str, Any]], oracle: dict[str, dict[str, Any]]) -> str:
    """Return the markdown table: one line per model, the worst of its parameter sets."""
    last = ["estimates in the mean", "oracle: worst share of allowed", "float = double"]
    head = ["model", "sets", *TESTS, *MEASURES, *last]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for kind in ROWS:
        mine = [row for row in rows if row["type"] == kind]
        if mine:
            lines.append("| " + " | ".join(cells(kind, mine, oracle)) + " |")
    return "\n".join(lines)


def cells(kind: str, mine: list[dict[str, Any]], oracle: dict[str, Any]) -> Iterator[str]:
    """Yield the cells of one model."""
    yield kind
    yield str(len(mine))
    for column in TESTS:
        verdicts = [row[precision][column] for row in mine for precision in PRECISIONS]
        free = " (not promised)" if all(v is None for v in verdicts) else ""
        yield f"FAIL {verdicts.count(False)}" if False in verdicts else f"pass{free}"
    for column, (_, worse) in MEASURES.items():
        values = [row[column] for row in mine if row[column] is not None]
        yield f"{worse(values):.2g}" if values else "-"
    walks = [row["estimate"] for row in mine if row["estimate"]]
    yield f"{len(walks) - walks.count('fail')} of {len(walks)} pass" if walks else "-"
    parts = {"": oracle.get(kind), " (tables)": oracle.get(f"{kind}, tables")}
    yield ", ".join(f"{worst['share']:.2f}{name}" for name, worst in parts.items() if worst) or "-"
    agree = all(row["float"] == row["double"] for row in mine)
    yield "agree" if agree else "DISAGREE"


def chosen(arguments: argparse.Namespace) -> list[Case]:
    """Return the parameter sets asked for, each once."""
    found = {case.id: case for case in (*all_cases(), *examples(), *walks())}
    kinds = arguments.models or list(ROWS)
    picked = []
    for kind in kinds:
        mine = [case for case in found.values() if case.type == kind]
        step = max(1, len(mine) // arguments.sample) if arguments.sample else 1
        picked += mine[::step]
    return picked


def main() -> int:
    """Judge what is missing, write JSON and table, print the table and every fault."""
    parser = argparse.ArgumentParser(description="Prove every material model.")
    parser.add_argument("models", nargs="*", help=", ".join(ROWS))
    parser.add_argument("--sample", type=int, help="parameter sets of each model (default: all)")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--no-oracle", action="store_true")
    parser.add_argument(
        "--oracle", action="store_true", help="only the worst comparison with each oracle"
    )
    arguments = parser.parse_args()
    if unknown := set(arguments.models) - set(ROWS):
        parser.error(f"no model is called {', '.join(sorted(unknown))}")
    arguments.out.mkdir(exist_ok=True)
    if arguments.oracle:
        print(oracle_table(oracle_worst(arguments.out / "oracle.json")))
        return 0
    store = arguments.out / "materials.json"
    build = mt.info()["source_hash"]
    kept = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}
    done = kept["rows"] if kept.get("build") == build else {}
    wanted = chosen(arguments)
    missing = [case for case in wanted if case.id not in done]
    print(f"{len(wanted)} parameter sets, {len(missing)} to judge", flush=True)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        jobs = {pool.submit(judge, case): case for case in missing}
        for count, job in enumerate(as_completed(jobs), 1):
            done[jobs[job].id] = job.result()
            if count % 20 == 0 or count == len(missing):
                store.write_text(json.dumps({"build": build, "rows": done}, indent=1) + "\n")
                print(f"{count} of {len(missing)}", flush=True)
    oracle = {} if arguments.no_oracle else oracle_worst(arguments.out / "oracle.json")
    rows = [done[case.id] for case in wanted]
    text = table(rows, oracle) + (f"\n\n{oracle_table(oracle)}" if oracle else "")
    (arguments.out / "materials.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    bad = [row for row in rows if row["faults"]]
    for row in bad:
        print(row["id"], json.dumps(row["faults"], indent=1))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
