"""Whether an FMU can be relied on: its description, its platforms, trials of its binary in a process of its own."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import fmpy
import fmpy.validation

from cosim import archive
from cosim.checks import check
from cosim.errors import CosimError
from cosim.fmu import read_description
from cosim.inspection import platforms
from cosim.isolation import describe_end
from cosim.ssp import STRUCTURE, read_package
from fmus_src.units import unit as named_unit

TIMEOUT = 60.0  # s
STEP = 0.0125  # s
Status = Literal["ok", "warning", "fail", "skipped"]
ORDER: tuple[Status, ...] = ("ok", "skipped", "warning", "fail")


@dataclass(frozen=True)
class Finding:
    """What one check found; `detail` is one line."""

    name: str
    status: Status
    detail: str


def validate(path: Path, step: float | None = None, timeout: float = TIMEOUT) -> list[Finding]:
    """Check an FMU, or an SSP package; binaries are loaded in another process, which may crash or hang without harm.

    Args:
        step: of the trials, s; by default the FMU's own, else 0.0125 s.
        timeout: wall time of all trials of an FMU, s.

    Raises:
        CosimError: no such file.
    """
    if not path.is_file():
        raise CosimError(f"FMU {path}: no such file")
    try:
        names = archive.entry_names(path)
        if STRUCTURE in names:
            return _package(path, len(names), step, timeout)
        findings = [Finding("archive", "ok", f"{len(names)} files, no path leads out")]
        md = read_description(path, validate=False)
    except CosimError as error:
        return [Finding("archive", "fail", str(error))]
    findings += [_description(path, md), _units(md), _causality(md)]
    platform = _platform(md, names)
    findings.append(platform)
    if platform.status != "ok":
        return [*findings, Finding("trials", "skipped", "nothing that runs here")]
    try:
        read_description(path)
    except CosimError:
        return [*findings, Finding("trials", "skipped", "mend the description first")]
    experiment = md.defaultExperiment
    usual = float(experiment.stepSize) if experiment is not None and experiment.stepSize else STEP
    return findings + _trials(path, usual if step is None else step, timeout)


def _package(path: Path, files: int, step: float | None, timeout: float) -> list[Finding]:
    """The structure, and one finding for each FMU: its worst."""
    findings = [Finding("archive", "ok", f"{files} files, no path leads out")]
    with tempfile.TemporaryDirectory(prefix="fowt-", ignore_cleanup_errors=True) as scratch:
        root = Path(scratch).resolve()
        try:
            system = read_package(path, root).system
            doubts = check(system).warnings
        except CosimError as error:
            return [*findings, Finding("structure", "fail", str(error).replace(f"{root}/", ""))]
        size = f"{len(system.components)} components, {len(system.connections)} connections"
        findings += [Finding("structure", "warning", w) for w in doubts] or [Finding("structure", "ok", size)]
        for fmu in dict.fromkeys(c.fmu.resolve() for c in system.components):
            found = validate(fmu, step, timeout)
            status = max((f.status for f in found), key=ORDER.index)
            worst = [f"{f.name}: {f.detail}" for f in found if f.status == status]
            detail = worst[0] if status in ("warning", "fail") else f"{len(found)} checks"
            findings.append(Finding(fmu.relative_to(root).as_posix(), "ok" if status == "skipped" else status, detail))
    return findings


def _description(path: Path, md: Any) -> Finding:
    """FMPy's checks: schema, names, model structure, start values, causality and variability."""
    own = [v for v in md.modelVariables if v.alias is None]
    try:
        problems = fmpy.validation.validate_fmu(str(path))
        if problems and len(own) < len(md.modelVariables):
            # FMPy wants aliases among the initial unknowns, where the variable that they name stands for all of them
            without = copy.copy(md)
            without.modelVariables = own
            plain = fmpy.validation.validate_model_description(without, validate_model_structure=True)
            about = "ModelStructure/InitialUnknowns"
            problems = [p for p in problems if not p.startswith(about)] + [p for p in plain if p.startswith(about)]
    except Exception as error:  # FMPy raises many kinds
        problems = [f"{type(error).__name__}: {error}"]
    if not problems:
        return Finding("description", "ok", "FMPy finds nothing")
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return Finding("description", "fail", " ".join(problems[0].split())[:300] + more)


def _units(md: Any) -> Finding:
    defined = {u.name for u in md.unitDefinitions if u.baseUnit is not None}
    named = (v.unit or (v.declaredType.unit if v.declaredType is not None else "") for v in md.modelVariables)
    used = {str(name) for name in named if name}
    lost: list[str] = []
    for name in sorted(used - defined):
        try:
            named_unit(name)
        except ValueError:
            lost.append(name)
    if lost:
        return Finding("units", "warning", f"not defined by base units and unknown: {', '.join(lost)}; not converted")
    bare = [
        str(v.name) for v in md.modelVariables
        if v.causality in ("input", "output") and v.type in ("Real", "Float64")
        and not (v.unit or (v.declaredType is not None and v.declaredType.unit))
    ]  # fmt: skip
    if bare:
        listed = ", ".join(bare[:6]) + (", ..." if len(bare) > 6 else "")
        return Finding("units", "warning", f"no unit, so values are passed unchanged: {listed}")
    return Finding("units", "ok", f"{len(used)} units, all resolved")


def _causality(md: Any) -> Finding:
    own = [v for v in md.modelVariables if v.alias is None]
    counts = {c: [v for v in own if v.causality == c] for c in ("input", "output", "parameter")}
    if not counts["output"]:
        return Finding("causality", "fail", "has no output: nothing can be connected to it")
    places: dict[Any, str] = {}
    for v in counts["input"]:
        key = (v.type, v.valueReference)
        if key in places:
            return Finding("causality", "fail", f"inputs {places[key]} and {v.name} have one value reference")
        places[key] = v.name
    return Finding("causality", "ok", ", ".join(f"{len(v)} {c}s" for c, v in counts.items()))


def _platform(md: Any, names: Sequence[str]) -> Finding:
    if md.coSimulation is None or md.fmiVersion not in ("2.0", "3.0"):
        kind = f"FMI {md.fmiVersion}" if md.coSimulation is not None else "no co-simulation"
        return Finding("platform", "fail", f"is {kind}; export it as FMI 2.0 or 3.0 for co-simulation")
    found = platforms(names)
    file = f"{md.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    if any(f"binaries/{folder}/{file}" in names for folder in (fmpy.platform, fmpy.platform_tuple)):
        return Finding("platform", "ok", f"binaries for {', '.join(found)}")
    has = f"has {', '.join(found)}" if found else "has none"
    sources = "; its sources can be compiled" if any(n.startswith("sources/") for n in names) else ""
    return Finding("platform", "fail", f"no binary {file} for {fmpy.platform}: {has}{sources}")


def _trials(path: Path, step: float, timeout: float) -> list[Finding]:
    with tempfile.TemporaryDirectory(prefix="fowt-", ignore_cleanup_errors=True) as scratch:
        folder, report = archive.extract(path, Path(scratch) / "fmu"), Path(scratch) / "report"
        report.touch()
        paths = [p or str(Path.cwd()) for p in sys.path]
        program = f"import sys; sys.path[:] = {paths!r}; from cosim.smoke import main; main()"
        words = [sys.executable, "-c", program, str(folder), repr(step), str(report)]
        log = Path(scratch) / "log"
        with log.open("wb") as printed:
            try:
                code = subprocess.run(
                    words, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT, timeout=timeout
                ).returncode
                end = describe_end(code) if code else ""
            except subprocess.TimeoutExpired:
                end = f"did not answer within {timeout:g} s"
        lines = [json.loads(line) for line in report.read_text(encoding="utf-8").splitlines()]
        if not end and not (lines and "end" in lines[-1]):
            end = "ended in the middle of a trial (exit code 0)"
        findings = [Finding(**line) for line in lines if "begin" not in line and "end" not in line]
        if end:
            during = lines[-1]["begin"] if lines and "begin" in lines[-1] else "start-up"
            findings.append(Finding(during, "fail", f"the process of the FMU {end}{_last_line(log)}"))
        return findings


def _last_line(log: Path) -> str:
    text = log.read_bytes()[-4000:].decode(errors="replace")
    last = next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")
    return f"; it last printed '{last[:200]}'" if last else ""
