"""Slips on the command line that Hydra answers at length, or wrongly: dashes before a key, blanks around `=`."""

from collections.abc import Sequence
from typing import NoReturn

from hydra._internal.utils import get_args_parser

from vehicle_sbi.errors import InputError


def check_slips(arguments: Sequence[str]) -> None:
    """Raise InputError for an option that Hydra lacks or that stands between keys, and for blanks around `=`."""
    for before, word, after in zip(["", *arguments], arguments, [*arguments[1:], ""], strict=False):
        if word.startswith("="):
            raise _blanks(before.rpartition("=")[2], word[1:] or after)
        if word.endswith("=") and after and "=" not in after and not after.startswith(("-", "+", "~")):
            raise _blanks(word[:-1], after)
    parser = get_args_parser()
    parser.error = _refuse
    _, unknown = parser.parse_known_args(arguments)
    for word in unknown:
        if not word.startswith("-"):
            raise InputError(f"{word} stands apart from other keys: write flags, as -m, before all keys")
        raise _unknown(word, arguments[[*arguments, word].index(word) + 1 :])


def _blanks(key: str, value: str) -> InputError:
    return InputError(f"leave no blanks around '=': write {key or 'key'}={value or 'value'}")


def _unknown(option: str, following: Sequence[str]) -> InputError:
    """An option as the key that was meant, with the value that came with it."""
    given, _, value = option.partition("=")
    after = "".join(following[:1])
    plain = "=" not in after and not after.startswith(("-", "+", "~"))
    meant = f"{given.lstrip('-')}={value or (plain and after) or '…'}"
    return InputError(f"unknown option {given}: keys are written without dashes, {meant}")


def _refuse(message: str) -> NoReturn:
    raise InputError(f"{message}; keys are written without dashes, as key=value")
