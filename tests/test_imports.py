"""A module imports only from those above it in the house's list, and configuration stays in scripts/ and tests/."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ORDER = """
errors plain_yaml files checkpoints parameters rng rounding words quoting compiled threads
physics.vehicle physics.size physics.tyre physics.magic_formula physics.signals physics.effects
physics.commands physics.body_forces physics.tyre_effects physics.record physics.sensors
physics.balance physics.axle physics.single_track physics.full_vehicle physics.rolling physics.simulation
data.channels data.recording data.masks data.smoothing data.windows data.cutting data.checks.drive data.checks.limits
data.checks.units data.checks.signs data.checks.offsets data.checks.shifts data.checks.samples data.plausibility
data.units data.time_units data.formats.limits data.formats.dates data.formats.table data.formats.lines
data.formats.text data.formats.vbo
data.formats.parquet data.formats.comma2k19 data.formats.matlab data.formats.ros_definitions data.formats.ros_messages
data.formats.ros_unpacking data.formats.rosbag data.formats.can_frames data.formats.can_log data.formats.mdf_blocks
data.elsewhere data.formats.registry data.formats.mdf data.mapping data.antialiasing data.readers data.together
data.inspection.units data.inspection.names data.inspection.contents data.inspection.guess data.inspection.excitation
data.inspection.presets
data.inspection.inspection data.inspection.spoken data.inspection.written data.manoeuvre data.noise
inference.prior inference.effect_prior inference.spike_slab inference.importance inference.simulator
inference.information inference.setup inference.informative inference.embedding inference.emulator inference.features
inference.estimator inference.training inference.proposal inference.doubts inference.rounds
inference.nuisances inference.reweighting inference.predictive inference.directions inference.plausible inference.study
inference.calibration inference.repetition
mismatch.problem.observation mismatch.problem.case mismatch.estimation.estimate mismatch.estimation.fit
mismatch.estimation.model mismatch.estimation.elsewhere mismatch.estimation.multistart mismatch.estimation.base_fit
mismatch.estimation.fit_check mismatch.estimation.linearised mismatch.estimation.expansion
mismatch.estimation.linear_gaussian mismatch.estimation.to_nulls
mismatch.hypotheses.hypothesis mismatch.hypotheses.block
mismatch.hypotheses.regressor mismatch.hypotheses.discrepancy mismatch.hypotheses.quantisation
mismatch.hypotheses.spans mismatch.hypotheses.effect mismatch.hypotheses.dictionary
mismatch.selection.score_test mismatch.selection.detection mismatch.selection.inverse mismatch.selection.likeness
mismatch.selection.coefficient mismatch.selection.gibbs mismatch.selection.inclusion mismatch.selection.ahead
mismatch.selection.pruned mismatch.selection.expand_and_prune mismatch.selection.extended
mismatch.selection.reinfer mismatch.selection.predictive
mismatch.selection.acceptance mismatch.design.cannot_act mismatch.design.identifiability mismatch.design.experiment
mismatch.answer.schema mismatch.answer.wording mismatch.answer.verdict mismatch.pipeline
report.manifest report.run_folder report.stage_file report.tables.symbols report.tables.posterior report.tables.text
report.tables.base_parameters report.tables.files report.tables.gathered report.density report.figures
report.mismatch_figures report.netcdf report.catalogue report.card report.extended report.page.thinning
report.page.charts report.page.parts report.page.page report.page.series report.page.diagnosis report.page.run
report.calibration report.page.index report.results report.diagnosis report.observability report.export.exported
report.export.car report.export.writing report.export.reading report.export.autoware report.export.openpilot
report.export.commonroad report.export.plain_json report.export.export
fleet.vehicles fleet.attended fleet.engine fleet.diagnoses fleet.table
command api
""".split()
RANK = {f"vehicle_sbi.{name}": rank for rank, name in enumerate(ORDER)}
DOOR = ROOT / "vehicle_sbi" / "__init__.py"  # what users import, from the last of them
MODULES = sorted((ROOT / "vehicle_sbi").rglob("*.py"))


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imported(path: Path) -> Iterator[str]:
    """Every module that a file imports, lazily or not; `from package import module` counts as the module."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}, line {node.lineno}: imports are absolute here"
            submodules = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in RANK else str(node.module) for name in submodules)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_imports_only_from_above_it(path: Path) -> None:
    module, ours = name_of(path), [name for name in imported(path) if name.split(".")[0] == "vehicle_sbi"]
    if path == DOOR:
        assert {*ours} == {"vehicle_sbi.api"}
        return
    if path.name == "__init__.py":
        assert not ours, f"{module} imports {', '.join(ours)}; packages here are only folders"
        return
    assert module in RANK, f"{module} has no place in the house: give it one in {Path(__file__).name}"
    below = [name for name in ours if RANK.get(name, len(RANK)) >= RANK[module]]
    assert not below, f"{module} imports {', '.join(below)}, which the house has below it"


@pytest.mark.parametrize("path", [*MODULES, *sorted((ROOT / "benchmarks").rglob("*.py"))], ids=name_of)
def test_only_scripts_know_of_hydra(path: Path) -> None:
    assert not {name.split(".")[0] for name in imported(path)} & {"hydra", "omegaconf"}
