"""Reports and plots: complete, readable, never 0 for unknown."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from film_scenes import scenes

import matiere as mt
from matiere.plot import error_plot, write_error_plot
from matiere.report import report_text

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def film() -> mt.Film:
    return mt.render(mt.load(scenes(32)["diffuse"]), spp=50, seed=2)


def test_the_report_is_plain_json(film: mt.Film) -> None:
    report = json.loads(json.dumps(film.report, allow_nan=False))
    assert report == film.report
    assert report["spp"] == 64 and report["requested"]["spp"] == 50
    assert report["spp_note"] == (
        "50 samples per pixel were asked for, rounded up to 64, whole passes"
    )
    assert report["reason"] == "spp" and report["seeds"] == [2]
    assert report["samples"] == 64 * 32 * 32
    error = report["error"]
    assert error["lower"] < error["relmse"] < error["upper"]
    se = error["standard_error"]
    assert 0 < se["mean"] < se["p95"] < se["max"]
    assert report["log"][-1]["relmse"] == error["relmse"]
    assert report["versions"]["matiere"] == mt.__version__
    image = report["image"]
    assert image["mean"] == pytest.approx(film.mean.mean(axis=(0, 1)).tolist(), rel=1e-12)
    light = image["luminance"]
    r, g, b = image["mean"]
    assert light["mean"] == pytest.approx(0.2126 * r + 0.7152 * g + 0.0722 * b, rel=1e-9)
    assert light["min"] < light["mean"] < light["max"]
    assert len(image["replicate_luminance"]) == film.replicates
    mean = sum(image["replicate_luminance"]) / film.replicates
    assert mean == pytest.approx(light["mean"], rel=1e-9)
    assert image["albedo"] is None, "no such layer was asked for"


def test_the_text_names_what_matters(film: mt.Film) -> None:
    text = report_text(film.report)
    for piece in ("64 spp", "stopped by spp", "relMSE", "95 %", "unknown", "CPU s", "rejected"):
        assert piece in text, piece
    assert "rounded up to 64" in text
    widths = {len(line) for line in text.splitlines() if line.strip().startswith(("spp ", "4 "))}
    assert len(widths) == 1


def test_unknown_is_said_in_words() -> None:
    document = scenes(16)["diffuse"]
    document |= {"shapes": [], "lights": [], "environment": {"radiance": 1.0}}
    film = mt.render(mt.load(document), spp=16)
    report = film.report
    assert report["error"]["relmse"] is None and report["error"]["unknown_share"] == 1
    assert report["error"]["standard_error"]["mean"] is None  # every replicate agrees
    assert any("the error is unknown" in line for line in report["warnings"])
    text = report_text(report)
    assert "relMSE unknown" in text
    with pytest.raises(ValueError, match="nothing to plot"):
        error_plot([("sky", report["log"])])


def test_one_replicate_says_that_the_error_is_unknown() -> None:
    film = mt.render(mt.load(scenes(16)["diffuse"]), spp=16, replicates=1)
    assert film.error["relmse"] is None
    assert film.report["error"]["standard_error"] == {"mean": None, "p95": None, "max": None}
    assert film.report["warnings"]


def row(seconds: float, relmse: float) -> dict[str, Any]:
    return {"wall_s": seconds, "relmse": relmse, "lower": relmse / 1.2, "upper": relmse * 1.2}


def curve(n: int, start: float = 0.1) -> list[dict[str, Any]]:
    return [row(start * 2**i, 0.5 / 2**i) for i in range(n)]


@pytest.mark.parametrize("count", [1, 2, 8, 24])
@pytest.mark.parametrize("looks", [1, 2, 20])
def test_plots_are_valid_svg_inside_their_frame(count: int, looks: int) -> None:
    text = error_plot([(f"film <{i}> & co", curve(looks, 0.1 + i)) for i in range(count)])
    root = ET.fromstring(text)
    width, height = float(root.get("width", 0)), float(root.get("height", 0))
    circles = root.findall(f"{SVG}circle")
    assert len(circles) == count * looks
    for c in circles:
        assert 0 < float(c.get("cx", 0)) < width and 0 < float(c.get("cy", 0)) < height
    words = [t.text or "" for t in root.findall(f"{SVG}text")]
    assert "render time / s (wall clock)" in words
    assert any("relMSE" in w for w in words)
    assert "film <0> & co" in words and "1 / time" in words


def test_longer_renders_lie_right_and_below() -> None:
    root = ET.fromstring(error_plot([("a", curve(5))]))
    at = [(float(c.get("cx", 0)), float(c.get("cy", 0))) for c in root.findall(f"{SVG}circle")]
    assert at == sorted(at)
    assert [y for _, y in at] == sorted(y for _, y in at)


def test_unknown_looks_are_left_out_of_the_plot(tmp_path: Path) -> None:
    log = [{"wall_s": 0.1, "relmse": None, "lower": None, "upper": None}, *curve(3)]
    path = tmp_path / "error.svg"
    write_error_plot(path, [("a", log)])
    assert len(ET.parse(path).getroot().findall(f"{SVG}circle")) == 3


def test_many_curves_become_their_spread() -> None:
    curves = [(f"cell {i}", curve(5, 0.1 * (1 + i / 100))) for i in range(60)]
    text = error_plot([*curves, ("<worst>", curve(3, 50.0))])
    root = ET.fromstring(text)
    words = "".join(root.itertext())
    assert "median of 61" in words and "largest error: <worst>" in words
    assert "middle half" in words and "cell 7" not in words
    assert text.count("<path") + text.count("<poly") + text.count("<line") < 200
    few = "".join(ET.fromstring(error_plot(curves[:24])).itertext())
    assert "cell 7" in few and "median" not in few
    ends = error_plot([(name, log[-1:]) for name, log in curves])
    assert "dots: ends of curves" in ends and "median" not in ends, "no curve has two looks"


def test_the_spread_lies_between_the_curves() -> None:
    from matiere.log_axis import LogAxis
    from matiere.plot import _points, _spread

    logs = [_points(curve(12, 0.1 * 2**i)) for i in range(-2, 3)]
    times = [look.seconds for looks in logs for look in looks]
    spread = [(t, q) for t, q in _spread(logs, LogAxis.around(times, 0, 100)) if 0.4 <= t <= 51]
    assert len(spread) > 20
    for t, q in spread:  # every curve is 0.5 * start / t; the starts are 0.1 times 1/4 to 4
        assert q == pytest.approx([0.05 * 2.0**i / t for i in range(-2, 3)])
