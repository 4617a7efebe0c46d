"""Where the reference of each comparison comes from: a folder of results, or the figures that ship with the package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cosim.errors import CosimError, nearest
from cosim.toml_file import read_toml
from cosim.verification.plan import Comparison
from cosim.verification.reference import READERS, find_history, read_history, read_row
from cosim.verification.table import Reference


def from_folder(folder: Path, plan: Mapping[str, Comparison]) -> dict[str, Reference]:
    """The references that a folder holds, by comparison.

    Raises:
        CosimError: there is no such folder, it holds none of them, or a file of it cannot be read.
    """
    if not folder.is_dir():
        raise CosimError(
            f"{folder}: no such folder; --against takes a folder of OpenFAST results (docs/verification.md)"
        )
    found = {}
    for name, comparison in plan.items():
        if comparison.table is not None:
            path = folder / comparison.table
            if path.is_file():
                found[name] = Reference(str(path), figures=read_row(path, comparison.row))
        elif history := find_history(folder, name):
            found[name] = Reference(str(history), read_history(history))
    if not found:
        first = ", ".join(list(plan)[:4])
        raise CosimError(
            f"{folder}: holds none of the results asked for, such as {first} ({', '.join(READERS)});"
            " name your own in a verification.toml there (docs/verification.md)"
        )
    return found


def from_figures(file: Path, plan: Mapping[str, Comparison]) -> tuple[dict[str, Comparison], dict[str, Reference]]:
    """The comparisons that a file of figures has something on, cut down to their checks with a figure, and the figures.

    Raises:
        CosimError: the file is malformed, or has a figure that no check asks for.
    """
    comparisons, references = {}, {}
    for name, channels in read_toml(file).items():
        if not isinstance(channels, dict):
            continue  # where the figures are from
        figures = {(channel, label): float(v) for channel, labels in channels.items() for label, v in labels.items()}
        if name in plan:
            known = {(c.channel, c.label) for c in plan[name].checks}
            for channel, label in figures:
                if (channel, label) not in known:
                    hint = nearest(f"{channel} {label}", (" ".join(k) for k in known))
                    raise CosimError(f"{file}: {name} has no check '{channel} {label}'{hint}")
            kept = tuple(c for c in plan[name].checks if (c.channel, c.label) in figures)
            comparisons[name] = replace(plan[name], checks=kept)
            references[name] = Reference(f"{file.name}: {name}", figures=figures)
    return comparisons, references
