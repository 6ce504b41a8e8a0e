"""Tables say what the samples say, to the digits they support; pages and pictures are whole and stand alone."""

import re
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from script_runs import run_script

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.prior import KNOWN
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.report import figures
from vehicle_sbi.report.page.run import lines
from vehicle_sbi.report.results import table_warnings
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.tables.files import write_tables
from vehicle_sbi.report.tables.gathered import gather
from vehicle_sbi.report.tables.posterior import (
    COLUMNS,
    NOT_IDENTIFIED,
    NOT_LEARNED,
    nominal_table,
    posterior_table,
    read_table,
    unidentified,
)
from vehicle_sbi.report.tables.symbols import minus, symbol
from vehicle_sbi.report.tables.text import SCREEN_WIDTH, for_people, html, terminal

ROOT = Path(__file__).resolve().parents[1]
PNG = b"\x89PNG\r\n\x1a\n"


def parameter(name: str, unit: str, low: float, high: float, *fields: str) -> Parameter:
    relative = name.startswith("delta_")
    return Parameter(
        name=name, unit=unit, low=low, high=high, fields=fields or (name,), relative=relative,
        scale=1e5 if relative else 1.0,
    )  # fmt: skip


SPACE = ParameterSpace(
    (
        parameter("l_f", "m", 1.0, 1.5),
        parameter("h_cog", "m", 0.2, 0.6),
        parameter("delta_C_kappa", "1e5 N", -0.2, 0.5, "C_kappa_f", "C_kappa_r"),
    )
)
TRUE = np.array([1.3, 0.4, 0.1])
NOMINAL = {"l_f": 1.3, "h_cog": 0.5, "C_kappa_f": 1e5, "C_kappa_r": 9e4}


def samples(n: int = 1000, seed: int = 0) -> np.ndarray:
    """A narrow l_f, an h_cog that is the prior, a middling delta_C_kappa."""
    g = np.random.default_rng(seed)
    columns = (g.normal(1.3, 0.009, n), g.uniform(0.2, 0.6, n), np.clip(g.normal(0.1, 0.08, n), -0.2, 0.5))
    return np.column_stack(columns)


def table(true: np.ndarray | None = TRUE, seed: int = 0) -> pd.DataFrame:
    return posterior_table(SPACE, samples(seed=seed), true=true, bound_std=np.array([0.008, np.inf, 0.07]))


def test_the_table_is_what_numpy_says() -> None:
    drawn, found = samples(), table()
    assert tuple(found.columns) == COLUMNS
    np.testing.assert_array_equal(
        found[["q05", "q50", "q95"]].to_numpy().T, np.quantile(drawn, [0.05, 0.5, 0.95], axis=0)
    )
    np.testing.assert_array_equal(found["std"], drawn.std(axis=0, ddof=1))
    np.testing.assert_array_equal(found["true"], TRUE)


def row_of(p: Parameter, mean: float, std: float) -> pd.DataFrame:
    """The table of one parameter whose posterior is normal."""
    space = ParameterSpace((p,))
    drawn = np.clip(np.random.default_rng(0).normal(mean, std, (2000, 1)), p.low, p.high)
    return posterior_table(space, drawn, bound_std=np.array([std]))


@pytest.mark.parametrize(
    ("name", "mean", "std", "said"),
    [
        ("steering_lag.time", 0.04, 0.028, ["steering_lag.time is compatible with 0"]),
        ("steering_lag.time", 0.04, 0.001, []),  # 4 % of the prior's width, and sure
        ("steering_lag.time", 0.99, 0.001, ["steering_lag.time lies on the edge of its prior"]),
        ("mu", 0.31, 0.005, ["mu lies on the edge of its prior"]),
    ],
)
def test_an_edge_of_a_prior_is_none_where_an_effect_vanishes(
    name: str, mean: float, std: float, said: list[str]
) -> None:
    warnings = table_warnings(row_of(KNOWN[name], mean, std), ParameterSpace((KNOWN[name],)))
    assert [line[: len(start)] for line, start in zip(warnings, said, strict=True)] == said


def test_the_prior_contracts_by_nothing() -> None:
    """s^2 of n uniform draws has relative standard deviation sqrt(0.8/n) (kurtosis 1.8); five of them are allowed."""
    n = 20_000
    drawn = np.random.default_rng(1).uniform(SPACE.low, SPACE.high, (n, len(SPACE)))
    found = posterior_table(SPACE, drawn, bound_std=np.full(len(SPACE), 1e-3))
    np.testing.assert_allclose(found["contraction"], 0.0, atol=5.0 * np.sqrt(0.8 / n))
    assert not found["identified"].any()
    assert found["true"].isna().all()


def test_identified_needs_a_bound_that_allows_it_and_a_posterior_that_shows_it() -> None:
    drawn = samples()
    known = [
        posterior_table(SPACE, drawn, bound_std=np.full(3, bound))["identified"].tolist()
        for bound in (0.01, np.nan, np.inf)
    ]
    assert known == [[True, False, True], [True, False, True], [False, False, False]]


def test_csv_keeps_every_digit_and_people_are_told_what_is_not_identified(tmp_path: Path) -> None:
    found = table()
    nominal = nominal_table(SPACE, NOMINAL, noise_percent={"C_kappa_f": 5.0})
    write_tables(tmp_path, found, nominal, ["3 of 1000 simulations failed"])
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "table.csv"), found, rtol=1e-15, atol=0.0)
    for text in (*((tmp_path / f"table.{kind}").read_text() for kind in ("md", "tex")), terminal(found)):
        assert text.count(NOT_IDENTIFIED) == 1
    assert "3 of 1000 simulations failed" in (tmp_path / "table.md").read_text()
    tex = (tmp_path / "table.tex").read_text()
    assert r"$l_{f}$ & $h_{\mathrm{cog}}$ & $\Delta C_{\kappa}$" in tex
    assert tex.count(r"\toprule") == tex.count(r"\bottomrule") == 2
    assert_is_a_latex_table(tex)


def test_what_the_recording_tells_and_the_run_has_not_learned_is_no_fault_of_the_recording(tmp_path: Path) -> None:
    found = posterior_table(SPACE, samples(), bound_std=np.full(3, 0.01))  # h_cog is left as its prior
    assert unidentified(found) == ["", NOT_LEARNED, ""]
    write_tables(tmp_path, found, nominal_table(SPACE, NOMINAL, noise_percent={}))
    shown = [(tmp_path / f"table.{kind}").read_text() for kind in ("md", "tex")]
    for text in (*shown, terminal(found), " ".join(lines(found)).lower(), *table_warnings(found, SPACE)):
        assert NOT_IDENTIFIED not in text
        assert "not learned" in text
    assert_is_a_latex_table(shown[1])


def assert_is_a_latex_table(tex: str) -> None:
    """Rows as wide as their columns; dollars and braces in pairs; nothing special to LaTeX, nor a hyphen, outside."""
    body = re.sub(r"^%.*$", "", tex, flags=re.MULTILINE)
    found = re.findall(r"\\begin{tabular}{(\w+)}\n(.*?)\\end{tabular}", body, flags=re.DOTALL)
    assert len(found) == 2
    for columns, rows in found:
        widths = {line.count("&") + 1 for line in rows.splitlines() if line.endswith(r"\\")}
        assert widths == {len(columns)}
    assert body.count("{") == body.count("}")
    assert body.count("$") % 2 == 0
    outside = re.sub(r"\\\W|\$[^$]*\$", "", body)  # without escaped characters and formulae
    assert not re.search(r"[_^%#~]|-\d|[^\x00-\x7f]", outside)


def test_nominal_values_have_their_parameters_unit() -> None:
    found = nominal_table(SPACE, NOMINAL, noise_percent={"C_kappa_f": 5.0})
    assert found["quantity"].tolist() == ["l_f", "h_cog", "C_kappa_f", "C_kappa_r"]
    assert found["nominal"].tolist() == [1.3, 0.5, 1.0, 0.9]
    assert found["noise_percent"].fillna(-1.0).tolist() == [-1.0, -1.0, 5.0, -1.0]


@pytest.mark.parametrize("length", [1, 30, 60])
def test_the_screen_is_never_exceeded(length: int) -> None:
    space = ParameterSpace((parameter("p" * length, "rad/(m/s^2)", -12345.0, 12345.0), *SPACE.parameters))
    drawn = np.column_stack([np.random.default_rng(0).normal(0.0, 0.01234, 1000), samples()])
    text = terminal(posterior_table(space, drawn, true=np.append(0.0, TRUE), bound_std=np.full(4, 0.01)))
    assert max(map(len, text.splitlines())) <= SCREEN_WIDTH
    assert all(p.name in text for p in space.parameters)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("-0.2 to -0.1", "−0.2 to −0.1"),
        ("(-0.04 ± 0.07)", "(−0.04 ± 0.07)"),
        ("-∞", "−∞"),
        ("1e-05", "1e-05"),
        ("SNPE-2, snake-case", "SNPE-2, snake-case"),
    ],
)
def test_hyphens_of_numbers_become_minus_signs_and_others_stay(text: str, shown: str) -> None:
    assert minus(text) == shown
    assert minus(text, "$-$") == shown.replace("−", "$-$")


def test_a_page_shows_powers_raised() -> None:
    text = html(for_people(table().assign(unit=["m^2", "rad/(m/s^2)", "1e5 N"])))
    for unit in ("<td>m<sup>2</sup></td>", "<td>rad/(m/s<sup>2</sup>)</td>", "<td>10<sup>5</sup> N</td>"):
        assert unit in text


def test_a_page_sets_columns_of_numbers_right_and_escapes_all() -> None:
    text = html(pd.DataFrame({"a < b": ["x > y", "z"], "p": ["-0.5", ""], "q": ["+1.0", "none"], "r": ["2", "3 %"]}))
    assert '<th>a &lt; b</th><th>p</th><th>q</th><th class="number">r</th>' in text
    assert "<td>x &gt; y</td><td>−0.5</td>" in text
    assert '<td class="number">3 %</td>' in text


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("C_alpha_f", r"$C_{\alpha f}$"),
        ("dC_kappa_r", r"$\Delta C_{\kappa r}$"),
        ("delta_C_alpha_f", r"$\Delta C_{\alpha f}$"),
        ("delta", r"$\delta$"),
        ("mu", r"$\mu$"),
        ("body_roll.gradient", "body roll: gradient"),
        ("steering_ratio", "steering ratio"),
    ],
)
def test_symbols(name: str, shown: str) -> None:
    assert symbol(name) == shown


def finished_run(path: Path, found: pd.DataFrame, seed: int, estimator: str = "nsf") -> None:
    config = {"seed": seed, "estimator": {"_target_": f"package.{estimator}"}}
    overrides = [f"seed={seed}", f"estimator={estimator}"]
    with RunFolder.open(path, config=config, overrides=overrides, inputs={}) as run:
        write_tables(path, found, nominal_table(SPACE, NOMINAL, noise_percent={}))
        run.complete()


def made_up_runs(folder: Path) -> None:
    """Ten seeds of one study, the truth outside the 90 % interval of l_f in three; one run of another study."""
    for seed in range(10):
        found = table(seed=seed)
        found.loc[found["parameter"] == "l_f", "true"] = 1.3 if seed >= 3 else 1.4
        finished_run(folder / f"seed={seed}", found, seed)
    finished_run(folder / "maf", table(true=None), 0, "maf")
    RunFolder.open(folder / "killed", config={"seed": 11}, overrides=[], inputs={}).close()


def test_gathering_counts_coverage_per_study(tmp_path: Path) -> None:
    made_up_runs(tmp_path)
    gathered = gather([tmp_path, tmp_path / "seed=4"])
    assert len(gathered.runs) == 11 * len(SPACE)
    assert gathered.left_out == (tmp_path / "killed",)
    l_f = gathered.seeds.query("study == 'estimator=nsf' and parameter == 'l_f'")
    assert l_f[["runs", "known", "covered", "coverage90"]].to_numpy().tolist() == [[10, 10, 7, 0.7]]
    std = gathered.runs.query("parameter == 'l_f' and estimator == 'nsf'")["std"].mean()
    np.testing.assert_allclose(l_f[["mean_std", "std_over_bound"]].to_numpy(), [[std, std / 0.008]])
    assert gathered.seeds.query("study == 'estimator=maf'")["coverage90"].isna().all()
    text = gathered.markdown()
    assert "7 of 10" in text
    assert "truth not known" in text
    assert "killed" in text


def test_gathering_names_what_it_cannot_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        gather([tmp_path / "absent"])
    with pytest.raises(InputError, match="no run folder"):
        gather([tmp_path])
    RunFolder.open(tmp_path / "killed", config={}, overrides=[], inputs={}).close()
    with pytest.raises(InputError, match="none of these runs has finished"):
        gather([tmp_path])
    finished_run(tmp_path / "run", table(), 0)
    file = tmp_path / "run" / "table.csv"
    table().drop(columns="q05").to_csv(file)
    with pytest.raises(InputError, match=r"table\.csv is damaged or missing"):
        gather([tmp_path])
    with pytest.raises(InputError, match="column q05 missing"):
        read_table(file)
    file.write_text("")
    with pytest.raises(InputError, match="not a table"):
        read_table(file)


@pytest.mark.slow
def test_the_script_gathers_and_refuses_in_one_line(tmp_path: Path) -> None:
    made_up_runs(tmp_path / "sweep")

    def report(runs: Path) -> tuple[int, str, str]:
        return run_script("report", f"runs=[{runs}]", f"hydra.run.dir={tmp_path / 'report'}")

    status, out, err = report(tmp_path / "sweep")
    assert status == 0, err
    assert "7 of 10" in out
    assert sorted(file.name for file in (tmp_path / "report").iterdir()) == [
        "index.html",
        "runs.csv",
        "runs.md",
        "seeds.csv",
    ]
    status, _, err = report(tmp_path / "absent")
    assert (status, err.count("\n")) == (2, 1)
    assert "no such folder" in err


def predicted(windows: int, time: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    g = np.random.default_rng(0)
    t = np.arange(windows * time).reshape(windows, time) / 100.0
    middle = np.sin(t.ravel())[None] * np.array([[1.0], [3.0]])
    measured = middle + 0.1 * g.standard_normal(middle.shape)
    measured[1, : time // 2] = np.nan
    valid = np.isfinite(measured)
    valid[:, -10:] = False
    return t, measured, np.stack([middle - 0.16, middle, middle + 0.16]), valid


def draw(name: str, path: Path) -> None:
    if name == "pairplot":
        figures.pairplot(samples(200), SPACE, TRUE, path)
    elif name == "predictive":
        figures.predictive(*predicted(3, 50), ["a_x", "yaw_rate"], ["m/s^2", "rad/s"], path)
    elif name == "losses":
        curve = {"training_loss": [3.0, 2.0, 1.0], "validation_loss": [3.0, 2.5, 2.6]}
        figures.losses([[curve, curve]] * 6, path)
    else:
        figures.contraction_bars(table(), path)


FIGURES = ["pairplot", "predictive", "losses", "contraction_bars"]


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_whole_pngs(tmp_path: Path, name: str) -> None:
    draw(name, tmp_path / "deeper" / "figure.png")
    assert (tmp_path / "deeper" / "figure.png").read_bytes().startswith(PNG)
    assert [file.name for file in (tmp_path / "deeper").iterdir()] == ["figure.png"]


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_an_exception_in_mid_write_leaves_the_earlier_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def half(figure: object, file: Any, **options: object) -> None:
        file.write(PNG)
        raise OSError(28, "No space left on device")

    (tmp_path / "figure.png").write_bytes(b"earlier")
    monkeypatch.setattr(figures.Figure, "savefig", half)
    with pytest.raises(OSError, match="No space left"):
        draw(name, tmp_path / "figure.png")
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"earlier"]


def test_a_picture_leaves_no_style_and_no_open_figure_behind(tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    for name in ("pairplot", "contraction_bars", "losses"):
        draw(name, tmp_path / "figure.png")
    assert dict(matplotlib.rcParams) == before
    assert plt.get_fignums() == []


def test_of_many_parameters_a_picture_of_pairs_has_the_constants_and_what_is_most_correlated() -> None:
    effects = tuple(Parameter(name=f"effect.{k}", unit="1", low=-9.0, high=9.0, fields=()) for k in range(14))
    space = ParameterSpace((*effects, *SPACE.parameters[:2]))
    free = np.random.default_rng(0).standard_normal((500, 16))
    free[:, 7:14] = 0.9 * free[:, [0]] + 0.1 * free[:, 7:14]
    assert figures._most_correlated(free, space) == [0, *range(7, 14), 14, 15]
    assert figures._most_correlated(free[:, :3], ParameterSpace(effects[:3])) == [0, 1, 2]


def test_a_posterior_without_width_can_be_drawn(tmp_path: Path) -> None:
    figures.pairplot(np.full((50, 2), (1.2, 0.3)), ParameterSpace(SPACE.parameters[:2]), None, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").exists()
