"""The masters that are compared: ours, FMPy's SSP simulation, libcosim. Each function runs in a process of its own.

Imports are inside the functions, so that a process holds what its contender needs and nothing else.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.case import Case, Sample

Run = Callable[[Case, float], Sample]
FMPY = "FMPy SSP"


def own_algorithms() -> list[tuple[str, str]]:
    """(algorithm, extrapolation) of every pair that our master accepts."""
    from typing import get_args, get_type_hints

    from cosim.errors import CosimError
    from cosim.run import RunSettings

    hints = get_type_hints(RunSettings)
    accepted = []
    for algorithm in get_args(hints["algorithm"]):
        for extrapolation in get_args(hints["extrapolation"]):
            try:
                RunSettings(stop=1.0, algorithm=algorithm, extrapolation=extrapolation).steps()
            except CosimError:
                continue
            accepted.append((algorithm, extrapolation))
    return accepted


def own_name(algorithm: str, extrapolation: str) -> str:
    """Label of our master with one of its algorithms."""
    return f"fowt {algorithm}, {extrapolation}"


def default_name() -> str:
    """Label of our master as it runs when nothing is chosen."""
    from cosim.run import RunSettings

    settings = RunSettings(stop=1.0)
    return own_name(settings.algorithm, settings.extrapolation)


def same_algorithm_name() -> str:
    """Label of our master with the algorithm that FMPy and libcosim have: Jacobi, inputs held over the step."""
    return own_name("jacobi", "held")


def own() -> dict[str, Run]:
    """Our master with each of its algorithms."""
    return {own_name(a, e): partial(run_own, algorithm=a, extrapolation=e) for a, e in own_algorithms()}


def others() -> dict[str, Run]:
    """The other masters, as far as they are installed."""
    found: dict[str, Run] = {FMPY: run_fmpy}
    if importlib.util.find_spec("libcosimpy"):
        found["libcosim threads"] = partial(run_libcosim, threads=True)
        found["libcosim one thread"] = partial(run_libcosim, threads=False)
    return found


def peak_memory() -> float:
    """Largest resident memory of this process until now, B."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage would count what the parent held when it forked
        return next(1024.0 * int(t.split()[1]) for t in status.read_text().splitlines() if t.startswith("VmHWM"))
    try:
        import resource
    except ImportError:
        return float("nan")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)


def run_own(case: Case, stop: float, algorithm: str, extrapolation: str) -> Sample:
    """Our master: `cosim.run.simulate` as a user calls it, with recording. Timed from the first progress report on."""
    from cosim.run import RunSettings, simulate
    from cosim.ssp import read_system

    marks: list[tuple[float, float, float]] = []

    def progress(reached: float) -> None:
        marks.append((reached, time.perf_counter(), time.process_time()))

    began = time.perf_counter()
    settings = RunSettings(
        stop=stop, step=case.step, algorithm=algorithm, extrapolation=extrapolation, record=case.compared  # type: ignore[arg-type]
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        result = simulate(read_system(case.folder / "SystemStructure.ssd"), settings, Path(folder) / "run", progress)
        total, memory = time.perf_counter() - began, peak_memory()  # before the results are read back
        frame = result.frame()
    first, last = marks[0], marks[-1]
    return Sample(
        steps=round((last[0] - first[0]) / case.step),
        seconds=last[1] - first[1],
        cpu_seconds=last[2] - first[2],
        total_seconds=total,
        peak_memory=memory,
        series={name: frame[name].to_list()[1:] for name in case.compared},
        component_seconds=result.component_seconds,
    )


def run_fmpy(case: Case, stop: float) -> Sample:
    """FMPy's `simulate_ssp`: its own loop, untouched and timed from the last initialisation to the first release.

    Its initialisation is replaced by ours: it ignores parameter bindings, cannot set texts, and starts every connected
    input at zero. What it simulated would be another system.
    """
    import fmpy.ssp.simulation as ssp
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    marks: list[tuple[float, float]] = []

    def instantiate(component: Any, folder: str, start_time: float, *unused: Any) -> None:
        path = str(Path(folder) / component.source)
        component.unzipdir = extract(path)
        description = read_model_description(path, validate=False)
        component.variables = {v.name: v for v in description.modelVariables}
        component.fmu = FMU2Slave(
            guid=description.guid, unzipDirectory=component.unzipdir, instanceName=component.name,
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        component.fmu.instantiate()
        component.fmu.setupExperiment(startTime=start_time)
        for name, value in {**case.start[component.name], **case.initial[component.name]}.items():
            reference = [component.variables[name].valueReference]
            if component.variables[name].type == "String":
                component.fmu.setString(reference, [str(value)])
            else:
                ssp.set_value(component, name, value)
        component.fmu.enterInitializationMode()
        component.fmu.exitInitializationMode()
        for connector in component.connectors:
            connector.value = case.initial[component.name].get(connector.name, 0.0)
        marks[:] = [(time.perf_counter(), time.process_time())]

    def free(component: Any) -> None:
        marks.append((time.perf_counter(), time.process_time()))
        original_free(component)

    original_instantiate, original_free = ssp.instantiate_fmu, ssp.free_fmu
    ssp.instantiate_fmu, ssp.free_fmu = instantiate, free
    try:
        began = time.perf_counter()
        # half a step less: its time adds up rounding errors, which would decide whether there is one step more
        rows = ssp.simulate_ssp(str(case.archive), stop_time=stop - 0.5 * case.step, step_size=case.step)
        total = time.perf_counter() - began
    finally:
        ssp.instantiate_fmu, ssp.free_fmu = original_instantiate, original_free
    return Sample(
        steps=len(rows),
        seconds=marks[1][0] - marks[0][0],
        cpu_seconds=marks[1][1] - marks[0][1],
        total_seconds=total,
        peak_memory=peak_memory(),
        series={name: rows[name].tolist() for name in case.compared},
    )


def run_libcosim(case: Case, stop: float, threads: bool) -> Sample:
    """libcosim's fixed-step algorithm on the same .ssd; timed after the first step, which initialises.

    Args:
        threads: as many as it takes by itself; else none beside its own, by the annotation in the .ssd.
    """
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.FATAL)
    steps = round(stop / case.step)
    began = time.perf_counter()
    step = round(case.step * 1e9) if threads else None  # given here, it replaces the annotation's algorithm
    execution = CosimExecution.from_ssp_file(str(case.folder), step_size=step)
    slaves = {name: execution.slave_index_from_instance_name(name) for name in case.components}
    references = {n: {v.name.decode(): v.reference for v in execution.slave_variables(i)} for n, i in slaves.items()}
    observer = CosimObserver.create_time_series(steps + 1)
    execution.add_observer(observer)
    observed = {}
    for name in case.compared:
        owner, variable = _split(name, case.components)
        observed[name] = slaves[owner], references[owner][variable]
        observer.start_time_series(*observed[name], CosimVariableType.REAL)
    if not execution.step():
        raise RuntimeError("libcosim: the first step failed")
    wall, cpu = time.perf_counter(), time.process_time()
    if not execution.simulate_until(round(stop * 1e9)):
        raise RuntimeError("libcosim: the simulation failed")
    wall, cpu, memory = time.perf_counter() - wall, time.process_time() - cpu, peak_memory()
    series = {name: observer.time_series_real_samples(*at, 1, steps)[2] for name, at in observed.items()}
    return Sample(steps - 1, wall, cpu, time.perf_counter() - began, memory, series)


def _split(name: str, components: tuple[str, ...]) -> tuple[str, str]:
    owner = max((c for c in components if name.startswith(f"{c}.")), key=len)
    return owner, name[len(owner) + 1 :]
