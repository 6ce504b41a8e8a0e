"""Standard output that takes no more: nobody reads on, as `head` does not, or the disk behind it is full."""

from vehicle_sbi.command import discard_output, leave_unread


def refusal(more: str = "") -> OSError | None:
    """What standard output answers to what is left to write and some more, None where it takes them; errors of a stream
    do not name it."""
    try:
        print(end=more, flush=True)
    except OSError as error:
        return error
    return None


def leave_if_unread(error: BaseException) -> None:
    """End quietly after an error that nobody reads on; return after any other."""
    if isinstance(error, BrokenPipeError) and isinstance(refusal("\n"), BrokenPipeError):  # what was left is dropped
        leave_unread()


def flush_or_discard() -> None:
    """Write what is left to write; what is refused is dropped, which Python would complain about in the end."""
    if refusal() is not None:
        discard_output()
