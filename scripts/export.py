"""Parameter files for other tools from a finished run or diagnosis: what was identified, its uncertainty, its caveats.

python scripts/export.py run=outputs/default format=autoware
"""

from _entry import launch  # first: it sets the number of threads

from pathlib import Path

from omegaconf import DictConfig


@launch("export")
def main(cfg: DictConfig) -> None:
    from vehicle_sbi.report.export.export import export
    from vehicle_sbi.report.export.writing import one_line

    written = export(Path(str(cfg.run)), str(cfg.format), None if cfg.to is None else Path(str(cfg.to)))
    print(*written.files, sep="\n")
    for name in written.left_out:
        print(f"{name} is not written: nothing that was identified has a key in it")
    print("\nCaveats, which the files repeat:", *(f"  {one_line(caveat)}" for caveat in written.caveats), sep="\n")


if __name__ == "__main__":
    main()
