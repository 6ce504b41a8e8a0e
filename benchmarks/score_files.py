"""Files of scores, MIX_SEED_NAME.jsonl: what a diagnosis is worth in each case, a line of JSON per case."""

import json
from pathlib import Path

SUFFIX = ".jsonl"


def called(diagnosis: str) -> str:
    """What a diagnosis is called that is given by its name or by the file of its scores, MIX_SEED_NAME.jsonl."""
    return Path(diagnosis).stem.rpartition("_")[2] if diagnosis.endswith(SUFFIX) else diagnosis


def lines_of(path: Path) -> dict[int, str]:
    """The lines of a file of scores by case; none where there is no file."""
    lines = path.read_text().splitlines() if path.exists() else []
    return {json.loads(line)["case"]: line for line in lines}
