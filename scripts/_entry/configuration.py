"""The project's configuration: the folder of its files, whose folders are Hydra's groups."""

from vehicle_sbi.command import CONF


def groups() -> set[str]:
    """Names of the groups that a user may choose an option of."""
    return {folder.name for folder in CONF.iterdir() if folder.is_dir() and folder.name != "hydra"}
