"""Errors of the co-simulation: one line each, naming component, variable, time, value and remedy where known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

LONGEST = 2000  # characters of a message; names in a file from elsewhere can be of any length


class CosimError(ValueError):
    """A system, a setting or a file that cannot be used; raised before the run starts.

    The message is cut to `LONGEST`, and holds nothing that a terminal would not print.
    """

    def __init__(self, message: str) -> None:
        text = "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in str(message))
        super().__init__(text if len(text) <= LONGEST else f"{text[:1200]} ... {text[-600:]}")


class RunFailed(RuntimeError):
    """A run that stopped before its end; what was computed until then is kept in its folder."""


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint such as "; did you mean 'force[1]'?", or the first few known names."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if close:
        return f"; did you mean '{close[0]}'?"
    some = ", ".join(f"'{n}'" for n in names[:6]) + (", ..." if len(names) > 6 else "")
    return f"; there are {some}" if names else "; there are none"
