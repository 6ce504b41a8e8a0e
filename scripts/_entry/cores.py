"""The cores that one study or diagnosis simulates on."""

from omegaconf import DictConfig

from vehicle_sbi.errors import InputError


def use_engine(engine: DictConfig) -> None:
    """Let simulations use the engine's cores. Raises InputError for a cluster, which shares out whole jobs alone."""
    from vehicle_sbi.threads import use_cores  # imports numpy, which reads the number of its threads

    if engine.name != "local":
        raise InputError(f"engine = {engine.name}: one study runs on this machine; fleet and prove take a cluster")
    use_cores(engine.cores)
