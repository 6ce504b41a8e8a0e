"""From finished rounds to everything a user takes away: samples, tables, figures, the page, and the screen."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.files import write_atomically
from vehicle_sbi.inference.doubts import EXTRAPOLATED, disagreements, unlike
from vehicle_sbi.inference.information import bound_std, confusable, fisher
from vehicle_sbi.inference.predictive import Predictive, predictive
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.reweighting import draws_about_the_fit, posterior_draws
from vehicle_sbi.inference.rounds import Inference, Problem
from vehicle_sbi.inference.simulator import STIFFNESSES
from vehicle_sbi.inference.study import Prepared
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.report import netcdf
from vehicle_sbi.report.figures import contraction_bars, losses, pairplot
from vehicle_sbi.report.figures import predictive as predictive_figure
from vehicle_sbi.report.page.page import write_page
from vehicle_sbi.report.page.run import page_of
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.tables.files import write_tables
from vehicle_sbi.report.tables.posterior import (
    NOT_LEARNED,
    maybe_none,
    nominal_table,
    on_edge,
    posterior_table,
    unidentified,
)
from vehicle_sbi.report.tables.text import terminal
from vehicle_sbi.rng import Stream, seed_torch
from vehicle_sbi.rounding import mean_and_std

FIRST_DRAWS = 1000  # of the first answer
EXACT = "by the likelihood: draws about the best fit, re-weighted"
ROUGH = "rough: a normal about the best fit (Laplace)"
LEAKING = 0.5  # acceptance below which the last round is warned about
WITH_EFFECTS = (
    "The effects that are free do not explain all of it; the posterior follows. "
    "If a diagnosis named them, its page says what they leave over."
)


@dataclass(frozen=True)
class Results:
    """What the posterior says: samples, Table II, and how it predicts the recording."""

    samples: Float[np.ndarray, "n d"]
    table: pd.DataFrame
    predicted: Predictive
    confusable: list[tuple[str, str, float]]
    reweighted: str | None = None  # how the draws were re-weighted, in a sentence


def results(prepared: Prepared, inference: Inference, *, samples: int, reweight: bool = True) -> Results:
    """Draw from the last posterior and hold it against truth, bound and recording.

    `reweight`: to the simulator's own likelihood, where that is known.
    """
    simulator = prepared.problem.simulator
    seed_torch(seed=simulator.seed, stream=Stream.POSTERIOR)
    if reweight:
        drawn, said = posterior_draws(prepared.problem, inference.posterior, samples)
    else:
        drawn, said = draw(inference.posterior, simulator.space, samples), None
    at = drawn.mean(axis=0) if prepared.truth is None else prepared.truth
    space, F = simulator.space, fisher(simulator, at)
    alone = bound_std(fisher(simulator.alone, at), space.prior_std) if len(simulator.plausible) else None
    bound = bound_std(F, space.prior_std)
    table = posterior_table(space, drawn, true=prepared.truth, bound_std=bound, bound_std_alone=alone)
    pairs = [(space.names[i], space.names[j], r) for i, j, r in confusable(F, space.prior_std)]
    return Results(drawn, table, predictive(simulator, prepared.problem.observed, drawn), pairs, said)


def first_answer(problem: Problem, effects: Sequence[str] = ()) -> str:
    """Means and standard deviations before any network is trained, of a model with the `effects`.

    They are exact within sampling error where the likelihood is known, else those about the best fit (Laplace's
    approximation).
    """
    if len(problem.simulator.plausible):
        return "No first answer: with plausible effects free no normal about a fit holds the posterior."
    fit = problem.laplace
    if fit is None:
        return (
            "No first answer: the best fit leaves over more than the noise, or the simulation fails beside it. "
            f"{WITH_EFFECTS if effects else '`diagnose` says what the model lacks.'}"
        )
    drawn = draws_about_the_fit(problem, FIRST_DRAWS)
    if drawn is not None and drawn.trusted:
        return _said_first(problem.simulator.space, drawn.theta.mean(axis=0), drawn.theta.std(axis=0, ddof=1), EXACT)
    mean, covariance = fit.marginal
    return _said_first(problem.simulator.space, mean, np.sqrt(np.diag(covariance)), ROUGH)


def _said_first(space: ParameterSpace, mean: np.ndarray, std: np.ndarray, how: str) -> str:
    """A line for each parameter, below how it was found."""
    width = max(map(len, space.names))
    said = [
        f"  {p.name:<{width}}  {mean_and_std(x, s)} {p.unit}".removesuffix(" 1") + _at_an_edge(p, x)
        for p, x, s in zip(space.parameters, mean, std, strict=True)
    ]
    return "\n".join([f"First answer, {how}. The posterior follows.", *said, ""])


def _at_an_edge(p: Parameter, mean: float) -> str:
    edge = on_edge(mean, p.low, p.high, p.null)
    return f" (on the edge of its prior, {p.low:g} to {p.high:g}: the model may lack something)" if edge else ""


def report(folder: RunFolder, prepared: Prepared, inference: Inference, *, samples: int, reweight: bool) -> None:
    """Write everything into the run folder, mark it complete, and print the table and where things are."""
    with folder.stage("results"):
        found = results(prepared, inference, samples=samples, reweight=reweight)
        write_samples(folder.path, found.samples, prepared, inference)
        origin = netcdf.Origin.of_folder(folder, prepared.name)
        netcdf.write(folder.path / netcdf.FILE, netcdf.of_run(prepared, found.samples, found.predicted, origin))
        notes = [*round_notes(inference), *filter(None, [found.reweighted])]
        warnings = warnings_of(prepared, inference, found.table)
        notes += [f"Hardly told apart: {a} and {b}: correlation {r:.2f}." for a, b, r in found.confusable]
        told = [*notes, *found.predicted.sentences(), *prepared.notes]
        folder.record(**facts(inference), confusable=found.confusable, notes=told, warnings=warnings)
        write_tables(folder.path, found.table, nominal(prepared), [*warnings, *told])
    with folder.stage("figures"):
        figures = write_figures(folder.path / "figures", found, prepared, inference)
    seconds = ", ".join(f"{stage} {time:.0f} s" for stage, time in folder.manifest["seconds"].items())
    told.append(f"Time: {seconds}; peak memory {folder.manifest['peak_memory_mb']} MB.")
    windows = prepared.problem.simulator.windows
    page = page_of(
        prepared.name,
        prepared.problem.simulator.space,
        found.samples,
        found.table,
        (windows, prepared.problem.observed, found.predicted.quantiles),
        path=folder.path / "report.html",
        figures=figures,
        notes=told,
        warnings=warnings,
    )
    write_page(folder.path / "report.html", page)
    folder.complete()


def show(folder: RunFolder) -> None:
    """Print the table of a finished run, what it says of itself, and the paths of what it wrote."""
    print(terminal(pd.read_csv(folder.path / "table.csv")))
    for line in (*folder.manifest["facts"]["warnings"], *folder.manifest["facts"]["notes"]):
        print(f"  {line}")
    written = "table.md, table.csv, table.tex, samples.parquet, posterior.nc, posterior.pt, figures/, report.html"
    print(f"\n{folder.path}: {written}")


def write_samples(path: Path, samples: np.ndarray, prepared: Prepared, inference: Inference) -> None:
    """samples.parquet with a named column per parameter, and posterior.pt, sbi's posterior at x_o."""
    frame = pd.DataFrame(samples, columns=list(prepared.problem.simulator.space.names))
    write_atomically(path / "samples.parquet", frame.to_parquet)
    write_atomically(path / "posterior.pt", lambda file: torch.save(inference.posterior, file))


def nominal(prepared: Prepared) -> pd.DataFrame:
    """The paper's Table I: nominal values and the process noise on them."""
    simulator = prepared.problem.simulator
    percent = 100 * simulator.process.stiffness.std
    return nominal_table(simulator.space, simulator.nominal, noise_percent=dict.fromkeys(STIFFNESSES, percent))


def write_figures(path: Path, found: Results, prepared: Prepared, inference: Inference) -> dict[str, Path]:
    """All figures of a run, by caption."""
    simulator, problem = prepared.problem.simulator, prepared.problem
    windows = simulator.windows
    measured = np.where(windows.valid, problem.observed, np.nan)
    pairplot(found.samples, simulator.space, prepared.truth, path / "pairplot.png")
    units = [CHANNELS[name].unit for name in windows.channels]
    predictive_figure(
        windows.clock,
        measured,
        found.predicted.quantiles,
        windows.valid,
        windows.channels,
        units,
        path / "predictive.png",
    )
    contraction_bars(found.table, path / "contraction.png")
    losses(history(inference), path / "losses.png")
    return {
        "Posterior in pairs: marginals on the diagonal, pairs below; red is the truth, where it is known.": path
        / "pairplot.png",
        "Posterior standard deviation against bound and prior.": path / "contraction.png",
        "Loss of every round.": path / "losses.png",
    }


def history(inference: Inference) -> list[list[dict[str, list[float]]]]:
    """Loss curves by round and member, as sbi's summaries name them."""
    return [
        [
            {"training_loss": training, "validation_loss": validation}
            for training, validation in zip(r.training_loss, r.validation_loss, strict=True)
        ]
        for r in inference.rounds
    ]


def facts(inference: Inference) -> dict[str, list]:
    """Plain numbers of each round for the manifest."""
    return {
        "failed_simulations": [r.failed for r in inference.rounds],
        "acceptance": [round(r.acceptance, 4) for r in inference.rounds],
        "surprise": [round(r.surprise, 3) for r in inference.rounds],
        "trained_on": [r.trained_on for r in inference.rounds],
        "epochs": [[len(loss) for loss in r.training_loss] for r in inference.rounds],
    }


def round_notes(inference: Inference) -> list[str]:
    """How the rounds went, in sentences."""
    failed, made = sum(r.failed for r in inference.rounds), sum(len(r.theta) for r in inference.rounds)
    inside = ", ".join(f"{r.acceptance:.0%}" for r in inference.rounds)
    return [
        f"{failed} of {made} simulations spun out or were not finite.",
        f"Share of the estimated density inside the prior, round by round: {inside}.",
    ]


def warnings_of(prepared: Prepared, inference: Inference, table: pd.DataFrame) -> list[str]:
    """Of the recording, of the rounds and of each parameter what to know before the table is relied on."""
    return [*prepared.warnings, *round_warnings(inference, table, prepared.problem.simulator.space)]


def round_warnings(inference: Inference, table: pd.DataFrame, space: ParameterSpace) -> list[str]:
    """What a reader must know before trusting the table: leakage, a recording unlike any simulation, rounds that
    disagree, prior edges."""
    last, warnings = inference.rounds[-1], []
    if last.acceptance < LEAKING:
        warnings.append(f"The last round leaks: only {last.acceptance:.0%} of its density lies inside the prior.")
    if last.surprise > EXTRAPOLATED:
        warnings.append(f"Last round: {unlike(last.surprise)}")
    moved = [f"{name} by {far:.1f}" for name, far in disagreements(inference.posteriors, space)]
    if moved:
        warnings.append(
            f"The last two rounds disagree: the mean moved of {', '.join(moved)} standard deviations of the round "
            "before. Use more simulations a round, and look for what the model lacks."
        )
    return [*warnings, *table_warnings(table, space)]


def table_warnings(table: pd.DataFrame, space: ParameterSpace) -> list[str]:
    """Of each parameter what its row alone warns of."""
    warnings = list[str]()
    for p, row, why in zip(space.parameters, table.to_dict("records"), unidentified(table), strict=True):
        if why == NOT_LEARNED:
            warnings.append(
                f"{p.name}: the recording tells it to {row['bound_std']:.2g} {p.unit}, but this run has not learned "
                "it; it needs more simulations or other features."
            )
        if row["identified"] and on_edge(row["q50"], p.low, p.high, p.null):
            warnings.append(
                f"{p.name} lies on the edge of its prior: widen the prior, or look for physics that the model lacks "
                "and this parameter makes up for."
            )
        if row["identified"] and maybe_none(row["mean"], row["std"], p.low, p.high, p.null):
            warnings.append(f"{p.name} is compatible with {p.null:g}, that is, with no effect.")
    return warnings
