"""A run's folder is called what its user typed, files by their names; studies that differ never share one."""

from _entry import LONGEST_NAME, study_name
from _entry.command_line import as_typed, spelled_out

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sbi.quoting import quoted, unquoted

HASHED = re.compile(r"-[0-9a-f]{8}$")
FILES = {
    "recording": ["drive.csv", "data/drive.csv", "/data/drive.csv", "my drive.csv", "drive.mcap", "ferrari_250lm"],
    "mapping": ["my.yaml", "maps/my.yaml", "autoware"],
    "vehicle": ["car.yaml", "cars/car.yaml", "bmw320i"],
    "seed": ["1"],
}


def named(*typed: str) -> str:
    """The name of what a command line asks for, as Hydra passes it on."""
    return study_name(spelled_out(typed))


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        (["recording=drive.csv"], "recording-drive.csv"),
        (
            ["recording=drive.csv", "mapping=my.yaml", "vehicle=car.yaml", "seed=3"],
            "mapping-my.yaml+recording-drive.csv+seed-3+vehicle-car.yaml",
        ),
        (["recording=drive.mcap", "mapping=autoware"], "mapping-autoware+recording-drive.mcap"),
        (["recording=volvo_s90_slalom"], "recording-volvo_s90_slalom"),
    ],
)
def test_files_of_this_folder_are_named_as_typed(typed: Sequence[str], name: str) -> None:
    assert named(*typed) == name


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        (["recording=/data/2024/drive.csv", "vehicle=cars/car.yaml"], "recording-drive.csv+vehicle-car.yaml"),
        (["recordings=[a/b.csv,'c d.csv']", "heldout=[x/e.csv]"], "heldout-e.csv+recordings-b.csv_c_d.csv"),
        (["recordings=[a.csv]", "recording=other.csv"], "recording-other.csv+recordings-a.csv"),
    ],
)
def test_what_is_left_out_of_a_name_leaves_eight_digits(typed: Sequence[str], name: str) -> None:
    found = named(*typed)
    assert HASHED.search(found)
    assert HASHED.sub("", found) == name


@pytest.mark.parametrize("column", ["Zeit[s]", "Time (ms)", "Time [s]", "t", "time_s"])
def test_a_column_of_times_is_typed_as_the_file_has_it(column: str) -> None:
    (spelled,) = spelled_out([f"recording.time={column}"])
    parsed = OverridesParser.create().parse_override(spelled)
    assert parsed.value() == column
    assert as_typed([spelled]) == [f"recording.time={column}"]


def test_names_of_different_files_differ_and_those_of_the_same_do_not_depend_on_their_order() -> None:
    names = {}
    for chosen in itertools.product(*([None, *values] for values in FILES.values())):
        typed = [f"{key}={value}" for key, value in zip(FILES, chosen, strict=True) if value]
        assert named(*typed) == named(*reversed(typed))
        assert len(named(*typed)) <= LONGEST_NAME + 9
        assert re.fullmatch(r"[\w.+-]+", named(*typed), flags=re.ASCII)
        names[chosen] = named(*typed)
    assert len(set(names.values())) == len(names)


def test_an_option_and_a_path_of_its_name_are_two_studies() -> None:
    assert named("recording=file", "recording.path=synthetic") != named("recording=synthetic")
    assert named("recording.mapping=autoware") != named("mapping=autoware")


def test_the_recording_that_a_list_implies_is_not_said_twice() -> None:
    assert named("recordings=[a.csv,b.csv]") == named("recordings=[a.csv,b.csv]", "recording=a.csv")


@given(st.text(min_size=1).map(lambda text: f"folder/{text}.csv"))
def test_a_command_line_is_found_again_in_what_hydra_is_given(path: str) -> None:
    typed = [f"recording={path}", f"vehicle={path}.yaml", f"mapping={path}.yml", "seed=1"]
    assert as_typed(spelled_out(typed)) == typed


NAMES = (
    "Fahrt_Übung.csv", "日本/走行.csv", "it's.csv", 'we said "x".csv', "my drive.csv", "a[1].csv", "k=v.csv", "a,b.csv",
    r"C:\Users\me\drive.csv", r"\\nas\logs\drive.csv", r"folder/ends\\"[:-1], r"folder/'\'\\'.csv", "two\nlines.csv",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("group", ["recording", "vehicle", "mapping"])
def test_a_path_reaches_hydra_as_it_is(group: str, name: str) -> None:
    typed = f"{group}={name}" if group == "recording" else f"{group}={name}.yaml"
    found = {o.key_or_group: o.value() for o in map(OverridesParser.create().parse_override, spelled_out([typed]))}
    assert found[{"mapping": "recording.mapping"}.get(group, f"{group}.path")] == typed.removeprefix(f"{group}=")


@pytest.mark.parametrize("typed", ["folder=Flotte_Ü", "to=結果/drive", "hydra.run.dir=outputs/Übung 1"])
def test_any_value_may_have_letters_that_hydra_does_not_know(typed: str) -> None:
    (word,) = spelled_out([typed])
    assert OverridesParser.create().parse_override(word).value() == typed.partition("=")[2]
    assert as_typed([word]) == [typed]


@pytest.mark.parametrize("typed", ["prior.h_cog=[0.4,0.6]", "+prior.h_cog=[0.4,0.6]", "++prior.h_cog=[0.4,0.6]"])
def test_a_parameter_may_be_new_to_the_prior(typed: str) -> None:
    assert spelled_out([typed]) == ["++prior.h_cog=[0.4,0.6]"]
    assert as_typed(spelled_out([typed])) == ["prior.h_cog=[0.4,0.6]"]
    assert spelled_out(["prior=lateral", "~prior.l_f"]) == ["prior=lateral", "~prior.l_f"]


def test_quotes_about_a_file_are_no_part_of_its_name() -> None:
    assert spelled_out(["recording='my drive.csv'"]) == spelled_out(["recording=my drive.csv"])


def test_a_list_of_files_may_have_such_letters_too() -> None:
    (word, *_) = spelled_out(["recordings=[Fahrt_Übung.csv, b.csv]"])
    assert OverridesParser.create().parse_override(word).value() == ["Fahrt_Übung.csv", "b.csv"]
    assert spelled_out(["recordings=[a.csv,b.csv]"])[0] == "recordings=[a.csv,b.csv]"


@given(st.text())
def test_a_quoted_text_is_what_hydra_reads_and_what_comes_back(text: str) -> None:
    parser = OverridesParser.create()
    assert parser.parse_override(f"key={quoted(text)}").value() == text
    assert parser.parse_override(f"key=[{quoted(text)},{quoted(text)}]").value() == [text, text]
    assert unquoted(quoted(text)) == text


def test_a_list_implies_its_first_recording_whatever_it_is_called() -> None:
    assert as_typed(spelled_out([f"recordings=[{quoted('it[1].csv')}]"])) == ["recordings=['it[1].csv']"]
    assert f"recording.path={quoted(NAMES[2])}" in spelled_out([f"recordings=[{quoted(NAMES[2])},b.csv]"])


def test_a_folder_is_a_recording_unless_a_configured_one_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("processed_log", "demo", "mine", "conf/recording"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "conf" / "recording" / "mine.yaml").touch()
    monkeypatch.chdir(tmp_path)
    assert spelled_out(["recording=processed_log"]) == ["recording=file", "recording.path='processed_log'"]
    assert named("recording=processed_log") == "recording-processed_log"
    assert spelled_out(["recording=demo", "recording=absent"]) == ["recording=demo", "recording=absent"]
    flag = ["--config-dir", "conf"]
    assert spelled_out([*flag, "recording=mine"]) == [*flag, "recording=mine"]
    assert spelled_out([f"recording={'x' * 5000}"]) == [f"recording={'x' * 5000}"]  # too long for any file
