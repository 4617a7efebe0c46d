"""What an FMU or an SSP package offers, without loading any binary of it."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import fmpy

from cosim import archive
from cosim.errors import CosimError
from cosim.fmu import read_description
from cosim.ssp import STRUCTURE, read_package
from cosim.system import StartValue

INTERFACES = ("ModelExchange", "CoSimulation", "ScheduledExecution")


def inspect(path: Path) -> dict[str, Any]:
    """Facts about an FMU or a package, as plain values for JSON.

    Raises:
        CosimError: it is neither, or cannot be read.
    """
    if not path.is_file():
        raise CosimError(f"{path}: no such file")
    names = archive.entry_names(path)
    if STRUCTURE in names:
        return inspect_package(path)
    if "modelDescription.xml" not in names:
        raise CosimError(f"{path}: has neither modelDescription.xml nor {STRUCTURE}; give an FMU or an SSP package")
    return inspect_fmu(path)


def inspect_fmu(path: Path) -> dict[str, Any]:
    """Facts about an FMU of FMI 1.0, 2.0 or 3.0.

    Raises:
        CosimError: it cannot be read.
    """
    names = archive.entry_names(path)
    md = read_description(path, validate=False)
    folders = platforms(names)
    return {
        "kind": "FMU",
        "file": str(path),
        "size": path.stat().st_size,
        "sha256": archive.sha256(path),
        "fmi": md.fmiVersion,
        "model": md.modelName,
        "description": md.description or "",
        "generator": md.generationTool or "",
        "generated": md.generationDateAndTime or "",
        "guid": md.guid or md.instantiationToken or "",
        "interfaces": {
            name: _capabilities(interface) for name in INTERFACES
            if (interface := getattr(md, name[0].lower() + name[1:], None)) is not None
        },
        "platforms": folders,
        "runs_here": bool({fmpy.platform, fmpy.platform_tuple} & set(folders)),
        "sources": [n for n in names if n.startswith("sources/")],
        "resources": [n for n in names if n.startswith("resources/")],
        "units": [u.name for u in md.unitDefinitions],
        "variables": [_variable(v) for v in md.modelVariables],
    }  # fmt: skip


def inspect_package(path: Path) -> dict[str, Any]:
    """Facts about an SSP package: what `fowt run` would take from it.

    Raises:
        CosimError: it cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="fowt-", ignore_cleanup_errors=True) as folder:
        root = archive.parse_xml(archive.read_entry(path, STRUCTURE), f"{path}: {STRUCTURE}")
        found = read_package(path, Path(folder))
        components = {c.name: (c, inspect_fmu(c.fmu)) for c in found.system.components}
        return {
            "kind": "SSP package",
            "file": str(path),
            "size": path.stat().st_size,
            "sha256": archive.sha256(path),
            "ssp": root.get("version") or "",
            "system": found.system.name,
            "components": {
                name: {
                    "fmu": str(c.fmu.relative_to(folder).as_posix()), "sha256": facts["sha256"], "fmi": facts["fmi"],
                    "interfaces": list(facts["interfaces"]), "platforms": facts["platforms"],
                    "generator": facts["generator"],
                    "parameters": {n: _shown(v, Path(folder)) for n, v in sorted(c.start.items())},
                }
                for name, (c, facts) in components.items()
            },
            "connections": [str(c) for c in found.system.connections],
            "outputs": [c.name for c in found.outputs],
            "start": found.start, "stop": found.stop, "step": found.step,
            "notes": list(found.system.notes),
            "files": list(archive.entry_names(path)),
        }  # fmt: skip


def platforms(names: Sequence[str]) -> list[str]:
    """Folders of binaries/ that hold a library."""
    libraries = (PurePosixPath(n) for n in names)
    return sorted({
        p.parts[1] for p in libraries
        if len(p.parts) == 3 and p.parts[0] == "binaries" and p.suffix in (".so", ".dll", ".dylib")
    })  # fmt: skip


def _capabilities(interface: Any) -> dict[str, Any]:
    """What an interface declares beyond FMI's defaults."""
    fields = {a.name: (getattr(interface, a.name), a.default) for a in interface.__attrs_attrs__}
    return {n: v for n, (v, default) in fields.items() if v != default and isinstance(v, (bool, int, float, str))}


def _shown(given: StartValue, folder: Path) -> str:
    if isinstance(given.value, str):
        return given.value.removeprefix(f"{folder.resolve()}/")
    return f"{given.value} {given.unit.name}" if given.unit else str(given.value)


def _variable(v: Any) -> dict[str, Any]:
    declared = v.declaredType
    unit = v.unit or (declared.unit if declared is not None else None)
    facts = {
        "name": v.name, "causality": v.causality or "local", "variability": v.variability or "",
        "type": f"{v.type}[{','.join(map(str, v.shape))}]" if v.shape else v.type,
        "unit": unit or "", "start": "" if v.start is None else str(v.start), "description": v.description or "",
    }  # fmt: skip
    limits = {n: str(getattr(v, n)) for n in ("min", "max") if getattr(v, n) is not None}
    return facts | limits
