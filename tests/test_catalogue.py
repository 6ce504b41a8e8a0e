"""The page of effects is that of the catalogue as it is, and its pictures show what an effect does."""

from pathlib import Path

import numpy as np
from cars import PAPER

from vehicle_sbi.data.manoeuvre import Manoeuvre
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.report.catalogue import SIMULATED, awake, exemplar, page, picture, response

DOCS = Path(__file__).resolve().parent.parent / "docs"
DRIVE = Manoeuvre(name="short", steering_amplitude=0.05, drive_torque=600.0, brake_torque=-900.0, duration=1.0)


def test_the_committed_page_is_the_one_the_catalogue_gives() -> None:
    assert (DOCS / "effects.md").read_text() == page("the paper car, full_vehicle", "paper_strong")
    assert {path.stem for path in (DOCS / "effects").glob("*.png")} == set(CATALOGUE)


def test_every_effect_and_parameter_is_on_the_page() -> None:
    text = page("a car", "a drive")
    for effect in CATALOGUE.values():
        assert text.count(f"### {effect.name}\n") == 1
        assert effect.equation in text
        assert all(f"`{p.name}`" in text for p in effect.parameters)


def test_a_picture_shows_the_effect_awake(tmp_path: Path) -> None:
    simulator, effect = exemplar(PAPER, DRIVE, "single_track"), CATALOGUE["accelerometer_bias"]
    change = response(simulator, awake(effect)) - response(simulator, {})
    expected = np.zeros((len(SIMULATED), 200))
    expected[:2] = 0.3  # half of the prior's 0.6 on both axes
    assert np.allclose(change, expected, rtol=0.0, atol=1e-12)
    picture(simulator, effect, tmp_path / "bias.png")
    assert (tmp_path / "bias.png").read_bytes().startswith(b"\x89PNG")
