"""Benchmarks `stepping` and `overhead`: what a communication step costs, with the FMUs and without them."""

from __future__ import annotations

from benchmarks.contenders import default_name, others, own, same_algorithm_name
from benchmarks.measure import Result, Settings, compare
from benchmarks.systems import chain, load_case, shell

# Same binaries, inputs and algorithm: what differs is the communication time that others add up or round to
# nanoseconds, measured 1e-12 on the chain and 1e-9 in the turbulent load case.
TOLERANCE = 1e-6
OVERHEAD_AIM = 0.5e-6  # s of CPU time per FMU and step


def stepping(settings: Settings) -> Result:
    """Wall time of a communication step: our master with each algorithm, FMPy and libcosim, on two systems."""
    runs = {**own(), **others()}
    light = chain(settings.folder / "chain", 120.0)
    result: Result = {"tolerance": TOLERANCE}
    result["chain"] = compare(
        light, runs, same_algorithm_name(), settings, stop=2.5 if settings.quick else light.stop, tolerance=TOLERANCE
    )
    if not settings.quick:
        turbine = load_case(settings.folder / "lc4", 30.0)
        result["lc4"] = compare(
            turbine, runs, same_algorithm_name(), settings, stop=turbine.stop, tolerance=TOLERANCE
        )  # fmt: skip
    return result


def overhead(settings: Settings) -> Result:
    """Time per FMU and step of the master alone: the FMUs' functions return at once.

    Laid out as load case 4 with two dampers: the same values, inputs and connections (quick: as the chain).
    """
    folder = settings.folder / "overhead"
    real = chain(folder / "real", 2.5) if settings.quick else load_case(folder / "real", 60.0)
    empty = shell(real, folder / "shell")
    result = compare(empty, {**own(), **others()}, default_name(), settings, stop=empty.stop)
    for contender in result["contenders"].values():
        for key in ("step_seconds", "cpu_step_seconds"):
            shares = {k: v / result["components"] for k, v in contender[key].items()}
            contender[key.replace("step_seconds", "fmu_step_seconds")] = shares
    default = result["contenders"][default_name()]["cpu_fmu_step_seconds"]["median"]
    return result | {"aim": OVERHEAD_AIM, "within_aim": default <= OVERHEAD_AIM}
