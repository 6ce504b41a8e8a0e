"""Text of parameter files: values to a digit more than their uncertainty supports, so that what is made of several of
them stays right, and comments that nothing in a name can break out of."""

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain

from vehicle_sbi.report.export.car import Entry
from vehicle_sbi.report.export.exported import Exported, Value
from vehicle_sbi.rounding import NONE, rounded

SURE = 0.995  # probability from which an effect's size is not conditional
WIDTH = 110  # columns of a comment
LEGEND = (
    "Values are posterior means. Beside each: unit; standard deviation; 5 % and 95 % quantiles; the parameters it is "
    "from. A value marked STATED is the vehicle file's, and nothing here has tested it. One ON THE EDGE OF ITS PRIOR "
    "is a limit that was assumed rather than a measurement. What is compatible with no effect is not written."
)


def one_line(text: str) -> str:
    """The text on one line, without what is not printable."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def comment(text: str, first: str = "# ", then: str = "# ") -> list[str]:
    """The text as lines of comments."""
    return textwrap.wrap(
        one_line(text), WIDTH, initial_indent=first, subsequent_indent=then, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def number(value: float) -> str:
    """A float with every digit, as YAML 1.1, JSON and Python read it: 1.0e-05, since YAML takes 1e-05 for text."""
    mantissa, e, exponent = repr(float(value)).partition("e")
    return mantissa + ("" if not e or "." in mantissa else ".0") + e + exponent


def head(title: str, known: Exported, remarks: Sequence[str] = ()) -> list[str]:
    """What a file opens with: what it is, where it comes from, and every caveat."""
    said = [title, f"Vehicle {known.vehicle}, from the {known.kind} in {known.folder}, vehicle-sbi {known.version}."]
    caveats = [line for caveat in (*remarks, *known.caveats) for line in comment(caveat, "# - ", "#   ")]
    return [*chain(*map(comment, [*said, LEGEND])), "# CAVEATS", *caveats]


def left_over(known: Exported, entries: Sequence[Entry]) -> list[str]:
    """What was not identified, and what was but has no key in these files."""
    unidentified = [f"{name}: {known.inferred[name].why_not}" for name in known.not_identified]
    lines = [*chain(*map(comment, unidentified))]
    for name in without_place(known, entries):
        one = known.inferred[name].estimate
        said = [f"{name} = {_spread(one.mean, one.std, one.unit)}: identified, no key here takes it"]
        lines += comment("; ".join([*said, *_conditions(known, [name])]))
    return lines


def without_place(known: Exported, entries: Sequence[Entry]) -> list[str]:
    """Identified parameters that none of the entries is made of."""
    used = {name for entry in entries if entry.value is not None for name in entry.value.slopes}
    return [name for name in known.identified if name not in used]


def has_identified(entries: Sequence[Entry]) -> bool:
    """Whether any entry says more than the vehicle file did."""
    return any(entry.value is not None and entry.value.slopes for entry in entries)


def lines_of(known: Exported, entries: Sequence[Entry], indent: str, between: str = ": ", end: str = "") -> list[str]:
    """A line for each entry: key and value with their remark, or a comment that says why there is none."""
    return [line for entry in entries for line in _line(known, entry, indent, between, end)]


def yaml_file(
    known: Exported,
    opening: Sequence[str],
    keys: Sequence[str],
    entries: Sequence[Entry],
    inner: Mapping[str, Sequence[Entry]] | None = None,
) -> str:
    """A YAML file of `entries` below nested `keys`, and beside them of the groups of entries in `inner`."""
    groups, depth = inner or {}, len(keys)
    nested = [f"{'  ' * i}{key}:" for i, key in enumerate(keys)]
    if nested and not _filled([*entries, *chain(*groups.values())]):
        nested[-1] += " {}"
    body = lines_of(known, entries, "  " * depth)
    for name, group in groups.items():
        opened = f"{'  ' * depth}{'' if _filled(group) else '# '}{name}:"
        body += [opened, *lines_of(known, group, "  " * (depth + 1))]
    return "\n".join([*opening, "", *nested, *body]) + "\n"


def _filled(entries: Sequence[Entry]) -> bool:
    return any(entry.value is not None for entry in entries)


def _line(known: Exported, entry: Entry, indent: str, between: str, end: str) -> Iterator[str]:
    if entry.value is None:
        yield f"{indent}# {one_line(f'{entry.key} left out: {entry.why}')}"
    else:
        value = number(_shown(known, entry.value))
        yield f"{indent}{entry.key}{between}{value}{end}  # {one_line(remark(known, entry))}"


def _shown(known: Exported, value: Value) -> float:
    """A value to the third digit of its standard deviation; one without any as it is."""
    fine = 0.1 * known.estimate(value).std
    return float(rounded(value.mean, fine)) if fine > NONE * abs(value.mean) else value.mean


def remark(known: Exported, entry: Entry) -> str:
    """Unit, uncertainty and origin of an entry's value, and its note."""
    value = entry.value
    if value is None:
        return entry.why
    unit = "" if value.unit in ("", "1") else value.unit
    if value.slopes:
        e = known.estimate(value)
        low, high = rounded(e.q05, e.std), rounded(e.q95, e.std)
        origin = f"std {rounded(e.std, e.std)}; 5 to 95 %: {low} to {high}; from {', '.join(value.slopes)}"
        origin += f", with {', '.join(entry.stated)} STATED" if entry.stated else ""
        edges = [name for name in value.slopes if known.inferred[name].on_edge]
        origin += "".join(f"; {condition}" for condition in _conditions(known, value.slopes))
        origin += f"; ON THE EDGE OF ITS PRIOR: {', '.join(edges)}" if edges else ""
    else:
        origin = "STATED, not identified"
    return "; ".join(part for part in (unit, origin, entry.note) if part)


def _conditions(known: Exported, names: Iterable[str]) -> list[str]:
    """What has to be missing for sizes to be there at all, or what is averaged over, unless it is certain."""
    found = {name.split(".")[0]: known.inferred[name] for name in names}
    doubtful = {effect: one for effect, one in found.items() if one.probability is not None and one.probability < SURE}
    return [
        f"averaged over whether {effect} is missing ({one.probability:.2f})"
        if one.averaged
        else f"if {effect} is missing ({one.probability:.2f})"
        for effect, one in doubtful.items()
    ]


def _spread(mean: float, std: float, unit: str) -> str:
    return f"{rounded(mean, std)} ± {rounded(std, std)}{'' if unit == '1' else f' {unit}'}"
