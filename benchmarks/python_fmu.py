"""Benchmark `python-fmu`: our damper FMU against the same damper built with PythonFMU."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import casadi as ca

from benchmarks.case import Case
from benchmarks.contenders import FMPY, others, own, same_algorithm_name
from benchmarks.measure import Bound, Result, Settings, difference, interleave, spread
from benchmarks.systems import write_case
from cosim.connect import connect
from fmus_src.component import Component
from fmus_src.export.build import build_fmu

# The same equations, inputs and Runge-Kutta steps, in another order of operations; the motion stays within the stops,
# which the exported component locates and the copy steps over.
TOLERANCE = 1e-9


def rocking_body() -> Component:
    """A body that rocks in pitch as prescribed and carries a damper at height h: theta = A sin(omega t)."""
    c = Component("rocking_body", "Body in prescribed pitch motion that carries a damper")
    amplitude = c.parameter("amplitude", 0.004, unit="rad", description="amplitude of pitch")
    omega = c.parameter("omega", 0.53, unit="rad/s", description="angular frequency of pitch")
    h = c.parameter("height", 87.6, unit="m", description="height of the damper above the pitch axis")
    g = c.parameter("gravity", 9.80665, unit="m/s2", description="gravitational acceleration")
    force = c.input("damper.force", 3, unit="N", description="force of the damper on the body, body frame")
    moment = c.input("damper.moment", 3, unit="N.m", description="moment of the damper on the body, body frame")
    theta, rate = amplitude * ca.sin(omega * c.time), amplitude * omega * ca.cos(omega * c.time)
    alpha = -(omega**2) * theta
    specific = ca.vertcat(h * alpha - g * ca.sin(theta), 0, g * ca.cos(theta) - h * rate**2)
    c.output("damper.specific_force", specific, unit="m/s2", description="acceleration less gravity, body frame")
    c.output("damper.angular_velocity", ca.vertcat(0, rate, 0), unit="rad/s", description="angular velocity")
    c.output("damper.angular_acceleration", ca.vertcat(0, alpha, 0), unit="rad/s2", description="its rate")
    c.output("moment", h * force[0] + moment[1], unit="N.m", description="pitch moment of the damper about the axis")
    return c


def python_fmu(settings: Settings) -> Result:
    """Wall time of a step: inside the damper's FMI functions (our master), and of FMPy's whole loop."""
    if not importlib.util.find_spec("pythonfmu"):
        return {"skipped": 'PythonFMU is not installed: pip install ".[benchmark]"'}
    stop = 5.0 if settings.quick else 60.0
    ours, theirs = cases(settings.folder / "python-fmu", stop)
    masters = {"fowt": own()[same_algorithm_name()], "FMPy": others()[FMPY]}
    runs = {
        f"{master} / {label}": Bound(run, case, stop)
        for master, run in masters.items()
        for label, case in (("exported FMU", ours), ("PythonFMU", theirs))
    }
    samples, failures = interleave(runs, settings, runs)
    contenders, agreement, steps = {}, {}, round(stop / ours.step)
    for master in masters:
        if {f"{master} / exported FMU", f"{master} / PythonFMU"} & set(failures):
            continue
        exported, python = samples[f"{master} / exported FMU"], samples[f"{master} / PythonFMU"]
        inside = bool(exported[0].component_seconds)
        # our master tells what each FMU took; of FMPy's loop only the whole is known
        fast, slow = (
            [s.component_seconds["damper"] / steps if inside else s.per_step for s in taken]
            for taken in (exported, python)
        )
        contenders[master] = {
            "measured": "inside the damper's FMI functions" if inside else "loop over both FMUs",
            "exported_step_seconds": spread(fast),
            "pythonfmu_step_seconds": spread(slow),
            "ratio": spread([b / a for a, b in zip(fast, slow, strict=True)]),
            "peak_memory": [exported[0].peak_memory, python[0].peak_memory],
        }
        agreement[master] = difference(exported[0], python[0])
    return {
        "stop": stop,
        "contenders": contenders,
        "failures": failures,
        "agreement": {"tolerance": TOLERANCE, "difference": agreement,
                      "agrees": {n: d <= TOLERANCE for n, d in agreement.items()}},
    }  # fmt: skip


def cases(folder: Path, stop: float) -> tuple[Case, Case]:
    """The body with our damper, and with PythonFMU's."""
    from pythonfmu.builder import FmuBuilder

    from fmus_src.tmd.model import component

    body = build_fmu(rocking_body(), folder)
    dampers = {"exported": build_fmu(component(), folder)}
    dampers["python"] = Path(FmuBuilder.build_FMU(Path(__file__).with_name("tmd_slave.py"), dest=folder))
    compared = ("damper.force[1]", "damper.force[3]", "damper.moment[2]")
    exported, python = (
        write_case(f"damper-{name}", f"body with damper ({name})", connect({"body": body, "damper": fmu}),
                   folder / f"system-{name}", compared, stop)
        for name, fmu in dampers.items()
    )  # fmt: skip
    return exported, python
