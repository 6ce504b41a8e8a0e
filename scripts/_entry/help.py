"""`--help` of a script: what it does and how it is called, then what may be chosen and what may be set."""

from _entry import configuration

import os
from collections.abc import Iterator, Mapping

import yaml

from vehicle_sbi.command import HELP, as_typed

FILES: Mapping[str, str] = {"recording": "or a file", "vehicle": "or a YAML file", "mapping": "or a YAML file"}
WIDTH = 14
HEAD = "key=value sets a key, group=name chooses an option; lists and spaces need quotes: 'effects=[aero_drag]'."
MORE = "--cfg job prints every key, -m sweeps over values, hydra.run.dir=FOLDER says where the results go."


def wanted(arguments: list[str]) -> bool:
    """Whether the user asks for help."""
    return any(argument in HELP for argument in arguments)


def text(docstring: str, config_name: str, script: str) -> str:
    """The help of a script, in the words of the command that it was called by."""
    verb = os.environ.get("VEHICLE_SBI_COMMAND", "").removeprefix("vehicle-sbi ")
    said = docstring.strip().replace("python scripts/", "  python scripts/")
    said = as_typed(verb, said) if verb else said
    config = yaml.safe_load((configuration.CONF / f"{config_name}.yaml").read_text(encoding="utf-8"))
    return "\n".join([said, "", HEAD, "", *_choices(config), *_settings(config), "", MORE])


def _choices(config: Mapping[str, object]) -> Iterator[str]:
    """Each group that the script takes, its default and its other options."""
    entries = config.get("defaults", [])
    for entry in entries if isinstance(entries, list) else []:
        if not isinstance(entry, Mapping):
            continue
        for group, chosen in entry.items():
            folder = configuration.CONF / str(group)
            if folder.is_dir():
                others = sorted(file.stem for file in folder.glob("*.yaml") if file.stem not in (chosen, "file"))
                names = [f"{chosen} (default)" if chosen else "none (default)", *others]
                yield f"  {group:<{WIDTH}} {', '.join([*names, *([FILES[group]] if group in FILES else [])])}"


def _settings(config: Mapping[str, object]) -> Iterator[str]:
    """Plain keys with their defaults."""
    for key, value in config.items():
        if key not in ("defaults", "hydra") and not isinstance(value, Mapping):
            yield f"  {key:<{WIDTH}} {'to be given' if value == '???' else 'null' if value is None else value}"
