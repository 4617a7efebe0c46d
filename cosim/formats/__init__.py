"""Results in the formats of other tools: `convert(folder, ["csv", "mat", "outb"])`.

`results.parquet` stays what everything here reads; these files follow from it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cosim.errors import CosimError, nearest
from cosim.formats.history import History, open_history
from cosim.formats.mat import write_mat
from cosim.formats.outb import write_outb
from cosim.formats.text import write_csv

WRITERS: Mapping[str, Callable[[History, Path], None]] = {"csv": write_csv, "mat": write_mat, "outb": write_outb}
ALWAYS = "parquet"


def format_names(text: str, option: str) -> tuple[str, ...]:
    """Formats of a list such as "csv,mat,outb", each once; "parquet", which every run writes, may be among them.

    Args:
        option: where the text comes from, for messages.

    Raises:
        CosimError: one is unknown, or none is named.
    """
    names = tuple(dict.fromkeys(n.strip().lower().removeprefix(".") for n in text.split(",") if n.strip()))
    for name in names:
        if name not in (*WRITERS, ALWAYS):
            raise CosimError(f"{option} {text}: no format '{name}'{nearest(name, WRITERS)}")
    if not names:
        raise CosimError(f"{option} names no format{nearest('', WRITERS)}")
    return tuple(n for n in names if n != ALWAYS)


def convert(folder: Path, formats: Sequence[str], target: Path | None = None) -> tuple[Path, ...]:
    """Write a run's results in other formats; returns the files. Each is written whole, or not at all.

    Args:
        folder: of a run, finished or broken off.
        formats: names among `WRITERS`.
        target: where to write, without suffix; default `folder/results`. What `convert` has written there before is
            replaced.

    Raises:
        CosimError: no such format, no results, a format cannot hold them, or writing fails.
    """
    for name in formats:
        if name not in WRITERS:
            raise CosimError(f"no format '{name}'{nearest(name, WRITERS)}")
    history = open_history(folder)
    base = target or folder / "results"
    written = []
    for name in formats:
        path = base.with_name(f"{base.name}.{name}")
        scratch = path.with_name(f"{path.name}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            WRITERS[name](history, scratch)
            scratch.replace(path)
        except CosimError as error:
            raise CosimError(f"{path}: {error}") from error
        except OSError as error:
            raise CosimError(
                f"{path}: writing failed: {error.strerror or error}; choose another folder, or free space"
            ) from error
        finally:
            with suppress(OSError):  # the error itself is what matters
                scratch.unlink(missing_ok=True)
        written.append(path)
    return tuple(written)
