"""Benchmark `memory`: peak memory of a run against its simulated time."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.contenders import default_name, own
from benchmarks.measure import Bound, Result, Settings, interleave
from benchmarks.systems import chain, load_case


def memory(settings: Settings) -> Result:
    """Peak memory of our master over runs of growing length, each in a process of its own."""
    lengths = (1.0, 4.0, 16.0) if settings.quick else (60.0, 300.0, 1200.0)
    folder = settings.folder / "memory"
    # one wind for all lengths: a longer one would take more memory by itself
    case = chain(folder, lengths[-1]) if settings.quick else load_case(folder, lengths[-1], longest=lengths[-1])
    run = own()[default_name()]
    once = replace(settings, quick=False, repeats=1)  # memory needs one run, in a process of its own for each length
    samples, failures = interleave({f"{t:g} s": Bound(run, case, t) for t in lengths}, once)
    if failures:
        raise RuntimeError(f"memory: {failures}")
    peaks = [taken[0].peak_memory for taken in samples.values()]
    return {
        "system": case.description,
        "simulated": list(lengths),
        "peak_memory": peaks,
        # from the second length on: before it, libraries still take memory that they then keep
        "growth": peaks[-1] / peaks[1] - 1.0,
    }
