"""Names and units of parameters as mathematics, and minus signs."""

import re

_GREEK = ("alpha", "beta", "gamma", "delta", "kappa", "lambda", "mu", "omega", "psi", "rho", "sigma", "tau", "zeta")


def symbol(name: str) -> str:
    r"""A parameter as mathematics where its name is a symbol (C_alpha_f: $C_{\alpha f}$), else in words.

    The result is valid mathtext and LaTeX. A leading `delta_` or `d` before a capital is an offset's Delta.
    """
    offset = re.match(r"(?:[dD]elta_|d)(?=[A-Z](?:_|$))", name)
    head, *below = name[offset.end() if offset else 0 :].split("_")
    if "." in name or (len(head) > 1 and head not in _GREEK):
        return name.replace(".", ": ").replace("_", " ")
    subscript = " ".join(_greek(part) if len(part) == 1 or part in _GREEK else rf"\mathrm{{{part}}}" for part in below)
    base = ("\\Delta " if offset else "") + _greek(head)
    return f"${base}_{{{subscript}}}$" if below else f"${base}$"


def _greek(word: str) -> str:
    return f"\\{word}" if word in _GREEK else word


def unit_symbol(unit: str) -> str:
    """A unit as mathtext and LaTeX, powers raised: "1e5 N/rad" is $10^5$ N/rad; "" for a pure number."""
    raised = re.sub(r"^1e(\d+)", r"$10^{\1}$", unit)
    return "" if unit == "1" else re.sub(r"\^(-?\d)", r"$^{\1}$", raised)


def minus(text: str, sign: str = "−") -> str:
    """The text with the hyphens before its numbers as minus signs; those in names and exponents stay."""
    return re.sub(r"(?<![\w.])-(?=[\d∞.])", lambda _: sign, text)
