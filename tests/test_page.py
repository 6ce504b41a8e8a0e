"""Pages stand alone, say everything, escape what they are given, and stay small; so does an index over many runs."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from bokeh.models import ColumnDataSource
from pages import HOSTILE, diagnosis_page, run_page
from test_report import PNG, finished_run, table

from vehicle_sbi.errors import InputError
from vehicle_sbi.mismatch.answer.schema import Unknown
from vehicle_sbi.mismatch.answer.wording import TOO_SMALL, as_a_whole
from vehicle_sbi.mismatch.estimation.estimate import Estimate
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics import sensors
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.report.page import page, parts
from vehicle_sbi.report.page.diagnosis import (
    CLAUSES,
    GROUPS,
    _bars,
    _explained,
    _range,
    _unknown,
    _where,
)
from vehicle_sbi.report.page.index import BROKEN, CALIBRATION, COMPLETE, DIAGNOSIS, RUN, UNFINISHED, rows, write_index
from vehicle_sbi.report.page.page import Page, write_page
from vehicle_sbi.report.page.parts import Listed, Picture, Section, Table, Words
from vehicle_sbi.report.page.run import headline
from vehicle_sbi.report.page.thinning import thinned
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.tables.base_parameters import NOT_TOLD, base_for_people

TEMPLATES = Path(page.__file__).parent / "templates"
LARGEST = 5_000_000  # bytes of a page
WORDS = 25  # of an explanation at most


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory: pytest.TempPathFactory) -> tuple[Page, str]:
    path = tmp_path_factory.mktemp("diagnosis") / "report.html"
    return diagnosis_page(path), path.read_text()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Page, str]:
    path = tmp_path_factory.mktemp("run") / "report.html"
    return run_page(path), path.read_text()


def assert_stands_alone(text: str) -> None:
    """Nothing that a browser would fetch: elements refer to nothing but the page and what it holds itself."""
    markup = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    sources = re.findall(r"""(?:src|href|srcset|action|data)=["']?([^"'\s>]+)""", markup)
    assert all(source.startswith(("data:", "#")) for source in sources), sources
    assert not re.search(r"@import|url\(|<link(?! rel=\"icon\" href=\"data:,\")|<iframe|<script [^>]*src", markup)


@pytest.mark.parametrize("kind", ["diagnosis", "run"])
def test_a_page_stands_alone_and_is_small(kind: str, request: pytest.FixtureRequest) -> None:
    _, text = request.getfixturevalue(kind)
    assert_stands_alone(text)
    assert len(text.encode()) < LARGEST


@pytest.mark.parametrize("kind", ["diagnosis", "run"])
def test_a_page_escapes_a_hostile_name_wherever_it_stands(kind: str, request: pytest.FixtureRequest) -> None:
    page, text = request.getfixturevalue(kind)
    assert HOSTILE in page.title
    assert HOSTILE not in text
    assert "a note &lt;script&gt;alert(1)&lt;/script&gt;" in text


@pytest.mark.parametrize("kind", ["diagnosis", "run"])
def test_a_page_says_what_comes_first_first_and_explains_every_chart(kind: str, request: pytest.FixtureRequest) -> None:
    page, text = request.getfixturevalue(kind)
    body = text[text.index("<body>") :]
    order = ["<h1>", 'class="curves"', "<details>", "<table"]
    assert [body.index(one) for one in order] == sorted(body.index(one) for one in order)
    for section in page.shown:
        assert 0 < len(section.said.split()) <= WORDS
    assert len(page.lines) <= 5
    assert body.count("<h1>") == 1


def test_the_page_of_a_diagnosis_holds_the_answer_and_its_warnings(diagnosis: tuple[Page, str]) -> None:
    page, text = diagnosis
    assert "body roll" in page.headline
    assert text.index('role="alert"') < text.index('class="curves"')
    assert "body_roll.gradient = " in text
    assert "Both models predict" in text
    assert "absorbed by" in text
    (curves, *_) = page.curves
    assert list(curves.keys)[:3] == ["recorded", "base", "extended"]


def test_a_page_never_denies_a_mismatch_that_it_names() -> None:
    found: Any = None  # which is asked for places alone
    answer: Any = SimpleNamespace(mismatch=[], detected=True, p_value=0.008)
    assert _where(answer, found) == Words([as_a_whole(answer)])
    answer.detected = False
    assert _where(answer, found) == Words(["Nowhere beyond noise."])


def test_a_size_whose_name_leaves_something_open_is_explained_in_a_clause() -> None:
    some = Estimate(0.5, 0.1, 0.3, 0.7, "m")
    assert _explained("imu_lever_arm.x", some).startswith("x = 0.50 ± 0.10 m (ahead of the centre of gravity")
    assert _explained("sensor_delay.can", some).endswith("(sensors of the mapping's group can)")
    assert _explained("relaxation.front", some) == "front = 0.50 ± 0.10 m"
    assert CLAUSES.keys() <= EFFECT_PARAMETERS.keys()
    assert GROUPS.keys() <= {*sensors.GROUPS}


def test_a_group_that_the_headline_names_has_a_bar_and_one_with_a_named_effect_has_none() -> None:
    answer: Any = SimpleNamespace(
        effects={"relaxation": 0.9, "sensor_delay": 0.45, "steering_delay": 0.4}, p_unknown=0.1, p_none=0.0,
        indistinguishable=[["sensor_delay", "steering_delay", "sensor_lag"], ["relaxation", "roll_steer"]],
        p_indistinguishable=[0.8, 0.95], explanations=[], unsupported=[], unknown=None,
    )  # fmt: skip
    named = [(bar.name, bar.share) for bar in _bars(answer)]
    group = ("sensor delay or steering delay or alike", 0.8)
    assert named[:4] == [("relaxation", 0.9), group, ("sensor delay", 0.45), ("steering delay", 0.4)]


def test_a_base_parameter_that_is_not_identified_is_said_so_on_the_page() -> None:
    e = {"mean": 1.2, "std": 0.1, "q05": 1.0, "q95": 1.4}
    p = Parameter(name="l_f", unit="m", low=1.0, high=1.5, fields=("l_f",))
    for identified, remark in ((True, ""), (False, NOT_TOLD)):
        values: Any = {"before": e, "after": e, "unit": "m", "identified": identified}
        assert _range(p, values).remark == remark
        assert [*base_for_people({"l_f": values})["identified"]] == [remark or "yes"]


def test_a_table_wraps_what_is_prose_and_keeps_numbers_and_names_on_a_line() -> None:
    text = "an axle loses cornering stiffness as load moves"
    drawn = Table(pd.DataFrame({"effect": ["relaxation"], "what it is": [text], "p": ["0.91"]})).markup
    assert f'<td>relaxation</td><td class="prose">{text}</td><td class="number">0.91</td>' in drawn
    style = (TEMPLATES / "style.css").read_text()
    assert "td.prose { white-space: normal;" in style


def test_a_page_has_no_table_without_rows_of_what_no_effect_explains() -> None:
    beyond_prior_alone = Unknown((), [], [], None)
    for unknown, p_unknown, said in (
        (None, 0.1, "Nothing beyond noise."), (None, 0.6, TOO_SMALL), (beyond_prior_alone, 0.6, TOO_SMALL),
    ):  # fmt: skip
        answer: Any = SimpleNamespace(unknown=unknown, p_unknown=p_unknown)
        assert _unknown(answer) == Words([said])


def test_the_page_of_a_run_says_what_was_told_and_what_was_not(run: tuple[Page, str]) -> None:
    page, text = run
    assert page.headline == "The recording identifies 1 of 3 parameters."
    assert page.lines[1].startswith("Not identified by this recording: ")
    assert text.count('class="dull"') == 2


def test_a_headline_counts(tmp_path: Path) -> None:
    found = table()
    assert headline(found.assign(identified=True)) == "The recording identifies all 3 parameters."
    assert headline(found.assign(identified=False)) == "The recording identifies none of 3 parameters."
    assert headline(found.assign(identified=True), alone=False) == "The recordings identify all 3 parameters."
    assert headline(found.iloc[:1].assign(identified=True)) == "The recording identifies the parameter."


def drawn_times(t: np.ndarray) -> np.ndarray:
    """The times of the points of a chart's first curve [s], of samples at `t` [s]."""
    from vehicle_sbi.report.page.charts import Series, chart

    y = np.sin(t)[None]
    grid, _ = chart(Series(t=t, channels=["a_y"], units=["m/s²"], curves={"recorded": y}), {"recorded": "recorded"})
    (source,) = grid.select({"type": ColumnDataSource})
    assert isinstance(source, ColumnDataSource)
    assert np.asarray(source.data["recorded_0"]).dtype == np.float32  # which keeps the page small
    return np.asarray(source.data["t"])


def test_a_clock_since_1970_keeps_every_sample_apart() -> None:
    t = 1_714_550_000.0 + np.arange(12_000) / 100.0
    np.testing.assert_array_equal(drawn_times(t), t)


@pytest.mark.slow
def test_an_hour_of_driving_stays_small(tmp_path: Path) -> None:
    """All channels at 100 Hz, with their simulations: 20 million numbers."""
    from vehicle_sbi.report.page.charts import Series, chart

    t = np.arange(3600 * 100) / 100.0
    y = np.random.default_rng(0).standard_normal((13, len(t)))
    series = Series(
        t=t, channels=[f"channel_{i}" for i in range(13)], units=["m/s²"] * 13,
        curves={"recorded": y, "base": y, "extended": y}, band=(y, y),
    )  # fmt: skip
    names = {"recorded": "recorded", "base": "base", "extended": "extended"}
    charts = [chart(series, names) for _ in range(3)]
    drawn = [parts.Curves(figure, names, "made up", every) for figure, every in charts]
    write_page(tmp_path / "report.html", Page(title="", headline="", shown=[Section(heading="", parts=drawn)]))
    assert (tmp_path / "report.html").stat().st_size < LARGEST
    assert f"least and the largest of every {charts[0][1]} samples" in (tmp_path / "report.html").read_text()


def test_thinning_keeps_every_spike_and_every_gap() -> None:
    t, spike = np.arange(100_000) / 100.0, 43_210
    y = np.zeros(len(t))
    y[spike] = 5.0
    kept = np.abs(t - 600.0) > 50.0
    found = thinned(t[kept], {"y": y[kept]}, values=4000)
    assert found.every > 1
    assert len(found.t) <= 4000
    assert np.nanmax(found.curves["y"]) == 5.0
    at = found.t[np.nanargmax(found.curves["y"])]
    assert abs(at - t[spike]) <= found.every / 100.0
    assert np.isnan(found.t).sum() == np.isnan(found.curves["y"]).sum() == 1


def test_what_is_short_is_not_thinned_and_bands_keep_their_edges() -> None:
    t = np.arange(100.0)
    y = np.sin(t)
    whole = thinned(t, {"y": y}, values=10)
    np.testing.assert_array_equal(whole.curves["y"], y)
    long = np.arange(10_000.0)
    band = thinned(long, {"a": np.sin(long), "b": np.sin(long)}, values=1500, edges={"a": False, "b": True})
    assert (band.curves["a"] < band.curves["b"]).all()


def test_parts_escape_what_they_are_given(tmp_path: Path) -> None:
    frame = pd.DataFrame({HOSTILE: [HOSTILE]})
    said = [Words([HOSTILE]), Listed([HOSTILE]), Table(frame, HOSTILE)]
    page = Page(
        title=HOSTILE, headline=HOSTILE, lines=[HOSTILE], warnings=[HOSTILE],
        shown=[Section(heading=HOSTILE, said=HOSTILE, parts=said)], folded=[Section(heading=HOSTILE, parts=said)],
    )  # fmt: skip
    write_page(tmp_path / "report.html", page)
    text = (tmp_path / "report.html").read_text()
    assert "<script" not in text  # without a chart there is none at all
    assert text.count("&lt;script&gt;") >= 15


@pytest.mark.parametrize(("size", "inside"), [(100, True), (parts.PICTURE_BYTES + 1, False)])
def test_a_large_picture_is_shown_from_its_file(tmp_path: Path, size: int, inside: bool) -> None:
    file = tmp_path / "figures" / "a.png"
    file.parent.mkdir()
    file.write_bytes(PNG + bytes(8) + (1500).to_bytes(4, "big") + bytes(size))
    picture = Picture(file, "a picture", tmp_path / "report.html")
    assert picture.width == 960
    assert picture.source.startswith("data:") == inside
    assert inside or picture.source == "figures/a.png"


@pytest.mark.parametrize(
    ("text", "shown"),
    [("2 m/s^2", "2 m/s²"), ("(1 ± 2) · 1e5 N/rad", "(1 ± 2) · 10⁵ N/rad"), ("1e-05 s", "1e-05 s"), ("x^-1", "x⁻¹")],
)
def test_powers_are_raised(text: str, shown: str) -> None:
    assert parts.raised(text) == shown


def diagnosis_folder(path: Path, headline: str) -> None:
    with RunFolder.open(path, config={}, overrides=[], inputs={}) as folder:
        (path / "verdict.json").write_text(json.dumps({"headline": headline}))
        (path / "report.html").write_text("")
        folder.complete()


def calibration_folder(path: Path) -> None:
    with RunFolder.open(path, config={}, overrides=[], inputs={}) as folder:
        rows = {"name": ["l_f", "h_cog"], "n": [100, 100], "verdict": ["consistent", "too narrow"]}
        pd.DataFrame(rows).to_csv(path / "calibration.csv", index=False)
        folder.complete()


def test_an_index_has_a_row_for_whatever_lies_there(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    finished_run(runs / "told", table(), 0)
    finished_run(runs / "damaged", table(), 0)
    (runs / "damaged" / "table.csv").write_text("")
    diagnosis_folder(runs / "a car", f"Missing: {HOSTILE}.")
    RunFolder.open(runs / "killed", config={}, overrides=[], inputs={}).close()
    calibration_folder(runs / "calibrated")
    (runs / "foreign").mkdir()
    (runs / "foreign" / "manifest.json").write_text("[]")
    found = {row.path.name: row for row in rows([runs, runs / "told"])}
    assert {name: (row.kind, row.status) for name, row in found.items()} == {
        "told": (RUN, COMPLETE), "damaged": (RUN, BROKEN), "a car": (DIAGNOSIS, COMPLETE),
        "killed": (RUN, UNFINISHED), "foreign": (RUN, BROKEN), "calibrated": (CALIBRATION, COMPLETE),
    }  # fmt: skip
    assert found["told"].headline == "The recording identifies 2 of 3 parameters."
    assert found["calibrated"].headline == "1 of 2 parameters consistent with 100 truths; h_cog too narrow."
    assert "damaged or missing" in found["damaged"].headline
    write_index(tmp_path / "report" / "index.html", [*found.values()])
    text = (tmp_path / "report" / "index.html").read_text()
    assert 'href="../runs/a%20car/report.html"' in text
    assert HOSTILE not in text
    assert "1 diagnosis, 4 runs and 1 calibration, of which 1 unfinished and 2 broken." in text


def test_an_index_refuses_a_folder_without_runs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        rows([tmp_path / "absent"])
    with pytest.raises(InputError, match="no run folder"):
        rows([tmp_path])
