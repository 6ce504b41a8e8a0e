"""YAML of anyone: what is beyond a configuration is one short line."""

from pathlib import Path

import pytest

from vehicle_sbi import plain_yaml

LONG = "1" * 400


@pytest.mark.parametrize(
    "number",
    [
        LONG,
        f"-{LONG}.5",
        f"{LONG}.0e+3",
        f"0x{LONG}",
        f"0b{LONG}",
        f"0{LONG}",
        "1:" + ":".join(["59"] * 99),
        f"!!int '0x{LONG}'",
    ],
)
def test_a_long_number_is_refused_in_whatever_notation(number: str, tmp_path: Path) -> None:
    (tmp_path / "car.yaml").write_text(f"L: 2.7\nm: {number}\n")
    with pytest.raises(plain_yaml.UnreadableYaml, match=r"^line 2: a number of more than 40 digits$"):
        plain_yaml.load(tmp_path / "car.yaml")


def test_a_long_text_is_none(tmp_path: Path) -> None:
    (tmp_path / "car.yaml").write_text(f"name: '{LONG}'\nsource: {'a long text ' * 9}\nm: 1500\n")
    assert plain_yaml.load(tmp_path / "car.yaml")["m"] == 1500
