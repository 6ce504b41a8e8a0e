"""What an inspection says on the screen: contents, mapping, what looks wrong, and what to type next."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from vehicle_sbi.data.inspection.contents import FEWEST, Column, Contents
from vehicle_sbi.data.inspection.guess import Guess
from vehicle_sbi.data.inspection.inspection import Inspection, time_settings

MOST_COLUMNS = 24  # lines on the screen; the rest is counted
MOST_NOTES = 8  # lines on what was changed in reading
LONGEST = 32  # characters of a column's name


def spoken(inspection: Inspection) -> str:
    """The whole of it but the next command."""
    parts = [
        _contents(inspection),
        _mapping(inspection),
        _lively(inspection),
        _left_out(inspection),
        _wrong(inspection),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def next_command(inspection: Inspection, mapping: Path | str, vehicle: Path, *, command: str) -> str:
    """What to type when the files are edited; `mapping` is a file or a preset's name."""
    times = [f"recording.{key}={_value(value)}" for key, value in time_settings(inspection.tables[0]).items()]
    words = [f"recording={inspection.path}", f"mapping={mapping}", f"vehicle={vehicle}", *times]
    return " ".join([command, *map(shlex.quote, words)])


def _value(text: str) -> str:
    """A value as Hydra's grammar reads it."""
    return text if text.replace("_", "").isalnum() else f'"{text}"'


def _contents(inspection: Inspection) -> list[str]:
    users = {column: one.channel for one in inspection.guesses for column in one.columns}
    lines = [f"{inspection.path}"]
    for table in inspection.tables:
        if table.clock.rows < FEWEST:
            rows = f"{table.clock.rows} row{'' if table.clock.rows == 1 else 's'}"
            lines.append(f"  {table.clock.name}: {rows}, too few for a signal")
        else:
            lines += [_clock(table), *_columns(table, users)]
    return lines


def _clock(table: Contents) -> str:
    clock = table.clock
    name = f"{clock.name}: " if clock.name else ""
    longest = max(clock.gaps, key=lambda gap: gap[1], default=(0.0, 0.0))
    count = f"{len(clock.gaps)} gap{'s' if len(clock.gaps) > 1 else ''}"
    gaps = f", {count}, the longest {longest[1]:.3g} s from {longest[0]:.2f} s" if clock.gaps else ", no gaps"
    back = f", {clock.back} times the clock does not go on" if clock.back else ""
    at = f"{clock.rows} rows in {clock.span:.4g} s, usually at {clock.rate:.4g} Hz{gaps}{back}"
    return f"  {name}{at}; time is '{clock.time}' [{clock.time_unit}]"


def _columns(table: Contents, users: dict[str, str]) -> Iterator[str]:
    """The columns that vary, those of channels first, and how many others there are."""
    varying = [column for column in table.columns if column.varies]
    shown = sorted(varying, key=lambda column: _place(column, users))[:MOST_COLUMNS]
    yield f"    {'column':<{LONGEST}} {'unit':>6} {'from':>10} {'to':>10} {'absent':>6}  channel"
    for column in shown:
        yield _column(column, users.get(column.address, ""))
    constant = [column.field for column in table.columns if not column.varies]
    for what, names in (
        ("not shown", [column.field for column in varying if column not in shown]),
        ("constant", constant),
        ("without numbers", table.other),
        ("not read, too large together", table.beyond),
    ):
        if names:
            more = f" and {len(names) - 8} more" if len(names) > 8 else ""
            yield f"    {what}: {', '.join(names[:8])}{more}"


def _place(column: Column, users: dict[str, str]) -> int:
    """The columns of channels come first, and those whose unit is known."""
    return 0 if column.address in users else 1 if column.unit else 2


def _column(column: Column, channel: str) -> str:
    name = column.field if len(column.field) <= LONGEST else f"{column.field[: LONGEST - 1]}…"
    absent = f"{column.absent:.0%}" if column.absent else ""
    return (
        f"    {name:<{LONGEST}} {column.unit or '?':>6} {column.low:>10.4g} {column.high:>10.4g} {absent:>6}  {channel}"
    ).rstrip()


def _mapping(inspection: Inspection) -> list[str]:
    missing = f"  missing: {', '.join(inspection.missing)}" if inspection.missing else ""
    if inspection.given:
        return [f"mapping as given: {', '.join(inspection.channels)}", *([missing] if missing else [])]
    return ["guessed mapping", *map(_guess, inspection.guesses), *([missing] if missing else [])]


def _guess(one: Guess) -> str:
    columns = (" + " if one.sign > 0 else " - ").join(one.columns)
    unit = f" in {one.unit} ({one.unit_from})" if one.unit else ""
    return f"  {one.channel:<16} {'-' if one.sign < 0 else ''}{columns}{unit}: {one.sure}{_also(one)}"


def _also(one: Guess) -> str:
    others: Sequence[str] = [f"or {', '.join(one.alternatives)}"] if one.alternatives else []
    radius = ["needs the wheel's radius"] if one.needs_radius else []
    return "".join(f"; {text}" for text in (*others, *radius))


def _lively(inspection: Inspection) -> list[str]:
    return ["how lively the drive is", *(f"  {line}" for line in inspection.lively)] if inspection.lively else []


def _left_out(inspection: Inspection) -> list[str]:
    """What reading leaves out or fills in (spikes, gaps), as far as there is room."""
    notes = [*inspection.notes]
    more = [f"and {len(notes) - MOST_NOTES} more"] if len(notes) > MOST_NOTES else []
    return ["what was changed in reading", *(f"  {line}" for line in [*notes[:MOST_NOTES], *more])] if notes else []


def _wrong(inspection: Inspection) -> list[str]:
    lines = [*([inspection.unread] if inspection.unread else []), *inspection.wrong]
    return ["what looks wrong", *(f"  - {line}" for line in lines or ["nothing that this drive tells"])]
