"""Seeds of wind and sea, or of a search, as every command reads them."""

from __future__ import annotations

import re
from collections import Counter

from cosim.errors import CosimError

FORM = "3, 1:6 or 1,4,7"
LARGEST = 2**31 - 1  # of an Integer variable of an FMU
MANY = 10_000  # runs that nobody means


def parsed_seeds(text: str, option: str = "--seeds") -> tuple[int, ...]:
    """Seeds in the order written: "3", a range "1:6" with both ends, several of either with commas, "1:3,8".

    Raises:
        CosimError: it is none of these, a range runs backwards, or a seed appears twice.
    """
    found: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*([0-9]+)\s*(?::\s*([0-9]+)\s*)?", part)
        if match is None:
            raise CosimError(f"{option} {text}: '{part.strip()}' is no seed; write whole numbers from 0, as {FORM}")
        first, last = int(match[1]), int(match[2] or match[1])
        if last > LARGEST or first > LARGEST:
            raise CosimError(f"{option} {text}: a seed is at most {LARGEST}")
        if last < first:
            raise CosimError(f"{option} {text}: the range {part.strip()} runs backwards; write {last}:{first}")
        if len(found) + last - first >= MANY:
            raise CosimError(f"{option} {text}: more than {MANY} seeds; write fewer, as {FORM}")
        found += range(first, last + 1)
    if len(set(found)) < len(found):
        twice = Counter(found).most_common(1)[0][0]
        raise CosimError(f"{option} {text}: seed {twice} appears twice; name each once")
    return tuple(found)
