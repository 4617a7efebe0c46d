"""The foreign FMU of FMI 3.0 of relay.c: an array of each numeric type, whose length is a structural parameter."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy

from fmus_src.export.compiler import compile_shared

TYPES = ("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean")


def description(*, intermediate: bool) -> str:
    """modelDescription.xml; `intermediate`: whether inputs may be set within a step."""
    yes = "true" if intermediate else "false"
    array = '<Dimension valueReference="50"/>'
    variables = ['<Float64 name="time" valueReference="60" causality="independent"/>']
    variables += ['<UInt64 name="length" valueReference="50" causality="structuralParameter" start="2"/>']
    for i, kind in enumerate(TYPES):
        start = "0 0.25" if kind == "Float64" else "false false" if kind == "Boolean" else "0 0"
        real = f' intermediateUpdate="{yes}"' if "Float" in kind else ""
        out = ' unit="m"' if kind == "Float64" else ""
        variables += [
            f'<{kind} name="in.{kind}" valueReference="{i}" causality="input"'
            f' variability="{"continuous" if "Float" in kind else "discrete"}" start="{start}"'
            f"{real}{out}>{array}</{kind}>",
            f'<{kind} name="out.{kind}" valueReference="{20 + i}" causality="output"{out}>{array}</{kind}>',
        ]
    variables += [
        '<Float64 name="fail_at" valueReference="40" causality="parameter" start="1e9" unit="s"/>',
        '<Int32 name="how" valueReference="41" causality="parameter" start="0"/>',
        f'<Float64 name="mean" valueReference="42" causality="output" unit="m">{array}<Alias name="average"/>'
        "</Float64>",
        '<Float64 name="level" valueReference="43" causality="output" unit="m"/>',
        '<String name="label" valueReference="44" causality="parameter"><Start value=""/></String>',
        '<Clock name="tick" valueReference="45" causality="local" intervalVariability="constant" intervalDecimal="1"/>',
    ]
    references = [*range(20, 20 + len(TYPES)), 42]
    outputs = "".join(f'<Output valueReference="{r}" dependencies=""/>' for r in references)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="relay" instantiationToken="relay">
<CoSimulation modelIdentifier="relay" canHandleVariableCommunicationStepSize="true" providesIntermediateUpdate="{yes}"/>
<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit><Unit name="s"><BaseUnit s="1"/></Unit></UnitDefinitions>
<ModelVariables>{"".join(variables)}</ModelVariables>
<ModelStructure>{outputs}<Output valueReference="43" dependencies="0"/></ModelStructure>
</fmiModelDescription>
"""


def relay(folder: Path, *, intermediate: bool = True) -> Path:
    """The FMU, compiled."""
    name = f"relay{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    library = compile_shared([Path(__file__).with_name("relay.c")], folder / name, [headers])
    path = folder / f"relay{'' if intermediate else '-held'}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description(intermediate=intermediate))
        archive.write(library, f"binaries/{fmpy.platform_tuple}/{name}")
    return path
