"""The C sources of an FMU: generated equations and description, beside the runtime."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable
from pathlib import Path

import casadi as ca
import numpy as np

from fmus_src.equations import Equations
from fmus_src.export.exported import Exported, Exports
from fmus_src.lookups import FieldLookup, ImplicitLookup, StoredLookup, SwitchLookup, TableLookup

RUNTIME = Path(__file__).parent / "runtime"
RUNTIME_SOURCES = (
    "instance.c", "course.c", "variables.c", "fmu_state.c", "directional.c",
    "lookup_table.c", "lookup_field.c", "lookup_implicit.c",
)  # fmt: skip
# Part of model.c, so that the compiler knows the sizes and can merge the integrator with the equations.
RUNTIME_INCLUDED = ("runtime.h", "instance.h", "evaluation.c", "integration.c")
INTERFACES = {"2": ("fmi2.c",), "3": ("fmi3.c", "fmi3_unused.c")}
COMPILED = {fmi: ("model.c", *files, *RUNTIME_SOURCES) for fmi, files in INTERFACES.items()}
FMI_HEADERS = {
    "2": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
# FMPy's copy of FMI 2.0's header leaves out the prefix of function names that the standard's has
_PREFIXED = (
    "#define fmi2FullName(name) name\n",
    "#if defined(FMI2_FUNCTION_PREFIX)\n  #define fmi2Paste(a,b) a ## b\n  #define fmi2PasteB(a,b) fmi2Paste(a,b)\n"
    "  #define fmi2FullName(name) fmi2PasteB(FMI2_FUNCTION_PREFIX, name)\n#else\n  #define fmi2FullName(name) name\n"
    "#endif\n",
)
MAX_FUNCTION_ARGUMENTS = 256  # MAX_ARGUMENTS of the runtime
MAX_IMPLICIT = 8
_PURPOSES = {"derivatives": "FOR_RATES", "outputs": "FOR_OUTPUTS", "update": "FOR_UPDATE", "switches": "FOR_SIGNS"}
_NONE = "{0, 0}"


def source_files(exports: Exports, guid: str, fmi: str = "2") -> dict[str, str]:
    """All C files of a component's FMU by name, headers of FMI included.

    Args:
        fmi: "2" or "3".

    Raises:
        ValueError: an equation exceeds a fixed size of the runtime.
    """
    files = {name: (RUNTIME / name).read_text() for name in (*RUNTIME_INCLUDED, *INTERFACES[fmi], *RUNTIME_SOURCES)}
    files |= {name: (fmi_headers() / name).read_text() for name in FMI_HEADERS[fmi]}
    if fmi == "2":
        header = FMI_HEADERS["2"][0]
        files[header] = files[header].replace(*_PREFIXED)
    files["names.h"] = names(exports.equations.component.name, files["instance.h"] + files["runtime.h"])
    files["runtime.h"] = '#include "names.h"\n' + files["runtime.h"]
    files["equations.c"] = equations_source(exports.equations)
    files["model.c"] = model_source(exports, guid)
    return files


def names(component: str, headers: str) -> str:
    """`names.h`: the runtime's functions under names of this component's own.

    With them, and FMI's functions under FMI2_FUNCTION_PREFIX or FMI3_FUNCTION_PREFIX, the sources of several FMUs go
    into one program.

    Args:
        headers: text of the runtime's headers, which declare them.
    """
    declared = re.findall(r"^(?!static|typedef)\w[\w ]*?[ *](\w+)(?:\(|;)", headers, re.MULTILINE)
    lines = [
        "/* So that the sources of several FMUs go into one program. */",
        *(f"#define {name} {component}_{name}" for name in declared),
        "#define CASADI_CODEGEN_PREFIX",
        f"#define CODEGEN_PREFIX {component}_equations_",
    ]
    return "\n".join(lines) + "\n"


def fmi_headers() -> Path:
    """Folder of the FMI headers that the installed fmpy carries."""
    import fmpy

    return Path(fmpy.__file__).parent / "c-code"


def equations_source(equations: Equations) -> str:
    """CasADi's C code for all functions of a component."""
    functions = [*equations.functions()]
    for lookup in equations.lookups:
        if isinstance(lookup, ImplicitLookup):
            if max(lookup.unknowns, lookup.row_size) > MAX_IMPLICIT:
                raise ValueError(f"{lookup.name}: at most {MAX_IMPLICIT} unknowns and arguments an equation")
            functions += lookup.functions
    generator = ca.CodeGenerator("equations", {"with_header": False})
    for function in functions:
        if max(function.sz_arg(), function.sz_res()) > MAX_FUNCTION_ARGUMENTS:
            raise ValueError(f"{equations.component.name}.{function.name()}: too many arguments for the runtime")
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        code = (Path(folder) / "equations.c").read_text()
    return _without_checks(code) if equations.component.sym is ca.SX else code


def _without_checks(code: str) -> str:
    """CasADi's scalar code without its tests for missing arguments and results: the runtime gives all of them."""
    code = re.sub(r"(arg\[\d+\])\? (\1\[\d+\]) : 0;", r"\2;", code)
    return re.sub(r"if \(res\[\d+\]!=0\) ", "", code)


def model_source(exports: Exports, guid: str) -> str:
    """`model.c`: the variables, lookups and functions as the runtime's tables."""
    equations = exports.equations
    component, sizes = equations.component, equations.sizes
    uses = [" | ".join(_PURPOSES[name] for name in names) or "0" for names in equations.lookup_uses()]
    given = component.directional_derivatives
    lookups = [_lookup(i, lookup, uses[i], given) for i, lookup in enumerate(equations.lookups)]
    longest = max((lookup.argument_size for lookup in equations.lookups), default=0)
    variables = [e for e in exports.all if e.role != "string"]
    rows = ",\n".join(_variable(e) for e in variables)
    strings = equations.strings
    counts = [
        sum(e.variable.size for e in variables), len(strings), len(lookups),
        *(sizes[key] for key in "xzupkwy"), longest,
    ]  # fmt: skip
    functions = [_equation(name) for name in ("calculate", "initial", "derivatives", "outputs", "update", "switches")]
    functions.append(_equation("forward") if given else _NONE)
    places = equations.switch_positions().tolist()
    return f"""/* Generated from the component's Python definition. */
#include <math.h>

#include "runtime.h"

#define CASADI_SYMBOL_EXPORT static
#include "equations.c"

static const variable variables[] = {{
{rows}
}};

static const char *const string_names[] = {{{_texts(v.name for v in strings)}}};
static const char *const string_starts[] = {{{_texts(v.text for v in strings)}}};

{"".join(declaration for declaration, _ in lookups)}
static const lookup lookups[] = {{
{",".join(entry for _, entry in lookups) or "    {TABLE, 0, 0, 0, {0}, {0}, 0}"}
}};

static const int switches_at[] = {{{", ".join(map(str, places)) or "0"}}};

const model_description model = {{
    {_text(component.name)}, {_text(guid)},
    {", ".join(str(n) for n in counts)},
    {component.internal_step!r}, {component.sample_time or 0.0!r},
    {int(component.sample_at_start)},
    {len(places)}, switches_at,
    variables, string_names, string_starts, lookups,
    {", ".join(functions)}
}};

#include "evaluation.c"
#include "integration.c"
"""


def _equation(name: str) -> str:
    return f"{{{name}, {name}_work}}"


def _text(value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
    return f'"{escaped}"'


def _texts(values: Iterable[str]) -> str:
    return ", ".join(_text(v) for v in values) or '""'


def number(value: float | None, otherwise: str = "0.0") -> str:
    """A C literal that reads back as the same double."""
    return otherwise if value is None else repr(float(value))


_ROLES = {
    "calculated": "CALCULATED",
    "input": "INPUT",
    "output": "OUTPUT",
    "state": "STATE",
    "sampled_state": "STATE",
    "time": "INDEPENDENT",
    "rate": "RATE",
    "indicator": "INDICATOR",
}


def _variable(e: Exported) -> str:
    """Rows of the runtime's table, one for each element."""
    v = e.variable
    kind = {"real": "REAL", "integer": "INTEGER", "boolean": "BOOLEAN"}[v.kind]
    role = _ROLES.get(e.role) or ("TUNABLE_PARAMETER" if v.tunable else "FIXED_PARAMETER")
    low, high, nominal = number(v.min, "-HUGE_VAL"), number(v.max, "HUGE_VAL"), number(v.nominal, "1.0")
    return ",\n".join(
        f"    {{{_text(name)}, {kind}, {role}, {0 if i else v.size}, {number(start)}, {low}, {high}, {nominal}}}"
        for i, (name, start) in enumerate(zip(e.element_names(), v.start, strict=True))
    )


def _lookup(i: int, lookup: object, uses: str, directional: bool) -> tuple[str, str]:
    """Declarations of a lookup's data, and its entry in the table."""
    forward = _equation(f"lookup{i}_forward") if directional else _NONE
    data = f"&lookup{i}_data"
    if isinstance(lookup, StoredLookup):
        kind, declaration, data = "STORED", "", "0"
    elif isinstance(lookup, SwitchLookup):
        kind, declaration, data = "SWITCH", "", "0"
    elif isinstance(lookup, TableLookup):
        values = _wrapped(number(x) for x in np.ravel(lookup.data))
        which = _wrapped(str(n) for n in lookup.which)
        _, points, columns = lookup.data.shape
        kind, declaration = "TABLE", (
            f"static const double table{i}_data[] = {{{values}}};\nstatic const int table{i}_which[] = {{{which}}};\n"
            f"static const table_data lookup{i}_data = {{table{i}_data, table{i}_which, {len(lookup.which)}, {points}, "
            f"{columns}, {number(lookup.first)}, {number(lookup.spacing)}}};\n"
        )  # fmt: skip
    elif isinstance(lookup, FieldLookup):
        kind = "FIELD"
        declaration = f"static const field_data lookup{i}_data = {{{lookup.points}, {lookup.file_index}}};\n"
    elif isinstance(lookup, ImplicitLookup):
        kind = "IMPLICIT"
        system, guess = _equation(f"{lookup.name}_system"), _equation(f"{lookup.name}_guess")
        declaration = (
            f"static const implicit_data lookup{i}_data = {{{_text(lookup.name)}, {system}, {guess}, "
            f"{lookup.unknowns}, {lookup.row_size}, {lookup.count}}};\n"
        )
    else:
        raise TypeError(f"no C runtime for {lookup!r}")
    entry = (
        f"    {{{kind}, {uses}, {lookup.argument_size}, {lookup.result_size}, {_equation(f'lookup{i}')}, "
        f"{forward}, {data}}}"
    )
    return declaration, entry


def _wrapped(items: Iterable[str]) -> str:
    """Comma-separated items with a line break now and then, which compilers and people prefer."""
    listed = list(items)
    lines = [", ".join(listed[i : i + 8]) for i in range(0, len(listed), 8)]
    return "\n    " + ",\n    ".join(lines) + "\n"
