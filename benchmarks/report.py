"""What a measurement leaves: tables on the terminal, results.json, benchmarks.png."""

from __future__ import annotations

import json
import os
import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.measure import Result

PACKAGES = ("fowt-cosim", "fmpy", "libcosimpy", "pythonfmu", "numpy", "scipy", "casadi", "ziglang")
COLOURS = {"fowt": "tab:blue", "FMPy": "tab:orange", "libcosim": "tab:green"}
Results = dict[str, Result]


def machine() -> Result:
    """What the figures were measured on, and with."""
    processor = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [t.split(":", 1)[1].strip() for t in info.read_text().splitlines() if t.startswith("model name")]
        processor = names[0] if names else processor
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "processor": processor, "cpus": os.cpu_count(), "system": platform.platform(), "versions": versions,
        "load_average": list(os.getloadavg()) if hasattr(os, "getloadavg") else [],
        "measured": datetime.now(UTC).isoformat(timespec="seconds"),
    }  # fmt: skip


def write(results: Results, about: Result, folder: Path) -> Path:
    """Write results.json."""
    path = folder / "results.json"
    path.write_text(json.dumps({**about, "benchmarks": results}, indent=1, allow_nan=True) + "\n", encoding="utf-8")
    return path


def disagreements(results: Results) -> list[str]:
    """A line for each contender whose results are not those of the others: its time means nothing."""
    found = []
    for name, result in results.items():
        for part in _parts(result):
            agreement = part.get("agreement", {})
            for contender, agrees in agreement.get("agrees", {}).items():
                if not agrees:
                    by, limit = agreement["difference"][contender], agreement["tolerance"]
                    found.append(f"{name}: {contender} differs by {by:.1e}, allowed {limit:.0e}")
            # what our master refuses (no ports to judge adaptive steps by, say) is said beforehand, not wrong
            failed = {c: why for c, why in part.get("failures", {}).items() if not why.startswith("CosimError")}
            found += [f"{name}: {contender} failed: {why}" for contender, why in failed.items()]
    return found


def show(results: Results, console: Console) -> None:
    """Print the tables."""
    shown = {
        "stepping": _show_stepping, "overhead": _show_overhead, "python-fmu": _show_python_fmu,
        "fitness": _show_fitness, "memory": _show_memory,
    }  # fmt: skip
    for name, result in results.items():
        if "skipped" in result:
            console.print(f"{name}: skipped, {result['skipped']}\n", markup=False)
        else:
            shown[name](result, console)


def _show_stepping(result: Result, console: Console) -> None:
    for part in _parts(result):
        table = _table(
            f"stepping: {part['system']}, {part['steps']} steps of {part['step']} s",
            "µs per step", "ratio", "CPU µs", "ratio", "run s", "peak MB", "difference",
        )  # fmt: skip
        found = part["agreement"]["difference"]
        for name, c in part["contenders"].items():
            table.add_row(
                name, _range(c["step_seconds"], 1e6), _range(c["ratio"]),
                _short(1e6 * c["cpu_step_seconds"]["median"]), _short(c["cpu_ratio"]["median"]),
                f"{c['total_seconds']['median']:.2f}", f"{c['peak_memory'] / 1e6:.0f}",
                f"{found[name]:.0e}" if name in found else "",
            )  # fmt: skip
        console.print(table)
        console.print(f"ratio and difference (at any communication point, share of the range): to {part['reference']}")
        for name, why in part["failures"].items():
            console.print(f"{name}: not run, {why}", markup=False)
        console.print()


def _show_overhead(part: Result, console: Console) -> None:
    table = _table(f"overhead of the master: {part['system']}", "µs per FMU and step", "ratio", "CPU µs", "ratio")
    for name, c in part["contenders"].items():
        cpu, ratio = (c[key]["median"] for key in ("cpu_fmu_step_seconds", "cpu_ratio"))
        table.add_row(
            name, _range(c["fmu_step_seconds"], 1e6), _range(c["ratio"]), _short(1e6 * cpu), _short(ratio)
        )  # fmt: skip
    console.print(table)
    aim = f"{1e6 * part['aim']:g} µs of CPU time with the default"
    console.print(f"ratio: to {part['reference']}; aim: {aim}: {'met' if part['within_aim'] else 'missed'}\n")


def _show_python_fmu(result: Result, console: Console) -> None:
    table = _table(f"one damper, {result['stop']:g} s: exported from Python, and PythonFMU",
                   "measured", "exported µs per step", "PythonFMU µs per step", "ratio")  # fmt: skip
    for name, c in result["contenders"].items():
        table.add_row(name, c["measured"], _range(c["exported_step_seconds"], 1e6),
                      _range(c["pythonfmu_step_seconds"], 1e6), _range(c["ratio"]))  # fmt: skip
    console.print(table)
    console.print()


def _show_fitness(result: Result, console: Console) -> None:
    table = _table(f"fitness: one free decay of {result['horizon']:g} s", "ms per evaluation", "ratio")
    for name, c in result["contenders"].items():
        table.add_row(name, _range(c["evaluation_seconds"], 1e3), _range(c["ratio"]))
    console.print(table)
    console.print(f"aim: {result['aim']:g} times: {'met' if result['within_aim'] else 'missed'}\n")


def _show_memory(result: Result, console: Console) -> None:
    table = _table(f"memory: {result['system']}", "         peak memory MB")
    for t, peak in zip(result["simulated"], result["peak_memory"], strict=True):
        table.add_row(f"{t:g} s", f"{peak / 1e6:.1f}")
    console.print(table)
    second, last = result["simulated"][1], result["simulated"][-1]
    console.print(f"growth from {second:g} to {last:g} s: {100 * result['growth']:.1f} %\n")


def _parts(result: Result) -> list[Result]:
    """The systems of a benchmark, or the benchmark itself."""
    inner = [v for v in result.values() if isinstance(v, dict) and "contenders" in v]
    return inner or [result]


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    for column in columns:
        table.add_column(column, justify="left" if column == "measured" else "right", no_wrap=True)
    return table


def _range(values: dict[str, float], factor: float = 1.0) -> str:
    """Median (least to largest)."""
    middle, low, high = (_short(factor * values[k]) for k in ("median", "min", "max"))
    return f"{middle} ({low}..{high})"


def _short(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def plot(results: Results, path: Path) -> Path:
    """Time per step, overhead, and memory over simulated time; whatever of these was measured."""
    from matplotlib.figure import Figure

    panels: list[tuple[str, str, Result, str]] = [
        (f"stepping: {p['system']}", "wall time per communication step (µs)", p, "step_seconds")
        for p in _parts(results.get("stepping", {})) if "contenders" in p
    ]  # fmt: skip
    if "overhead" in results:
        part = results["overhead"]
        panels.append((f"overhead: {part['system']}", "CPU time per FMU and step (µs)", part, "cpu_fmu_step_seconds"))
    count = len(panels) + ("memory" in results)
    if not count:
        return path
    tallest = max([len(p[2]["contenders"]) for p in panels], default=6)
    rows = (count + 1) // 2
    figure = Figure(figsize=(6.5 * min(count, 2), rows * max(3.2, 0.26 * tallest + 1.2)), layout="constrained")
    axes = figure.subplots(rows, min(count, 2), squeeze=False).ravel()
    for ax, panel in zip(axes, panels, strict=False):
        _times(ax, *panel)
    if "memory" in results:
        _memory(axes[count - 1], results["memory"])
    for ax in axes[count:]:
        ax.set_visible(False)
    figure.savefig(path, dpi=110)
    return path


def _times(ax: Any, title: str, label: str, part: Result, key: str) -> None:
    """A point per contender, with its spread, on a logarithmic axis."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    names = list(part["contenders"])
    groups: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        groups.setdefault(name.split()[0], []).append(row)
    values = [{k: 1e6 * v for k, v in part["contenders"][n][key].items()} for n in names]
    for group, rows in groups.items():
        middle = [values[r]["median"] for r in rows]
        below = [values[r]["median"] - values[r]["min"] for r in rows]
        above = [values[r]["max"] - values[r]["median"] for r in rows]
        ax.errorbar(middle, rows, xerr=(below, above), fmt="o", color=COLOURS[group], capsize=3, label=group)
    for row, v in enumerate(values):
        ax.annotate(
            _short(v["median"]), (v["max"], row), xytext=(6, 0), textcoords="offset points", va="center", size=8
        )
    if "aim" in part:
        ax.axvline(1e6 * part["aim"], color="black", linestyle="--", linewidth=1, label=f"aim {1e6 * part['aim']:g} µs")
    ax.set_yticks(range(len(names)), names, size=8)
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlim(min(v["min"] for v in values) / 1.5, 3.0 * max(v["max"] for v in values))
    ax.invert_yaxis()
    ax.set_title(title, size=10)
    ax.set_xlabel(f"{label}: median, least to largest")
    ax.grid(axis="both", alpha=0.3)
    ax.legend(fontsize=8)


def _memory(ax: Any, result: Result) -> None:
    ax.plot(result["simulated"], [p / 1e6 for p in result["peak_memory"]], "o-", label="fowt, default algorithm")
    ax.set_ylim(0.0, 1.25 * max(result["peak_memory"]) / 1e6)
    ax.set_xlim(0.0, None)
    ax.set_title(f"memory: {result['system']}", fontsize=10)
    ax.set_xlabel("simulated time (s)")
    ax.set_ylabel("peak resident memory (MB)")
    ax.grid(alpha=0.3)
    ax.legend(loc="lower right", fontsize=8)
