"""Design variables held against the FMUs that have them: do they exist, in which unit, within which limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

from fmpy import read_model_description

from optimisation.objective import Design, DesignVariable

SI = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def checked_variables(task: Design, fmu_of: Callable[[str], tuple[Path, str]]) -> Design:
    """The design with its variables' units, each held against the FMU that has it.

    Args:
        fmu_of: name of a variable -> FMU and the variable's name there.

    Raises:
        ValueError: an FMU has no such real parameter, or a bound is beyond those that it declares.
    """
    return replace(task, variables=tuple(_checked(v, *fmu_of(v.name)) for v in task.variables))


def _checked(variable: DesignVariable, fmu: Path, name: str) -> DesignVariable:
    variables, units = _parameters(fmu, fmu.stat().st_mtime_ns)
    if name not in variables:
        close = get_close_matches(name, variables, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else f"; it has {', '.join(list(variables)[:8])}, ..."
        raise ValueError(f"variable {variable.name}: {fmu.name} has no real parameter '{name}'{hint}")
    unit, least, most = variables[name]
    if (least is not None and variable.lower < least) or (most is not None and variable.upper > most):
        limit = f"at least {least:g}" if least is not None and variable.lower < least else f"at most {most:g}"
        raise ValueError(
            f"variable {variable.name}={variable.lower:g}:{variable.upper:g}: {fmu.name} needs {limit} {unit}"
        )
    return replace(variable, unit=unit, base=units.get(unit, {}))


@cache
def _parameters(
    fmu: Path, modified: int
) -> tuple[dict[str, tuple[str, float | None, float | None]], dict[str, dict[str, float]]]:
    """Real parameters of an FMU with unit and bounds, and base units of its units."""
    description = read_model_description(str(fmu))
    units = {
        u.name: {base: value for base in SI if (value := getattr(u.baseUnit, base))}
        for u in description.unitDefinitions
        if u.baseUnit is not None
    }

    def number(text: Any) -> float | None:
        return None if text is None else float(text)

    found = {
        v.name: (v.unit or "", number(v.min), number(v.max))
        for v in description.modelVariables
        if v.type == "Real" and v.causality == "parameter"
    }
    return found, units
