"""Configuration files that the user brings: their size and depth are checked before Hydra reads them."""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

from vehicle_sbi.errors import InputError
from vehicle_sbi.plain_yaml import UnreadableYaml, check

FLAGS = ("--config-dir", "-cd", "--config-path", "-cp")


def check_config_folders(arguments: Sequence[str]) -> None:
    """Raise InputError for a YAML file of a `--config-dir` that is more than a configuration can be."""
    for folder in config_folders(arguments):
        for file in sorted(Path(folder).rglob("*.yaml")):
            try:
                check(file)
            except UnreadableYaml as error:
                raise InputError(f"{file}: {error}") from None


def config_folders(arguments: Sequence[str]) -> Iterator[str]:
    """What follows the flags, after a blank or an equals sign."""
    for argument, following in itertools.pairwise([*arguments, ""]):
        flag, equals, value = argument.partition("=")
        if flag in FLAGS:
            yield value if equals else following
