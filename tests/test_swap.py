"""A damper from elsewhere in the place of ours: names mapped, units converted, and the same motion."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd
import pytest

from cosim.case import read_case
from cosim.checks import check
from cosim.cli.run import Changes, prepare
from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.run import simulate
from cosim.ssp_parameters import read_mapping
from cosim.swap import NameRule, with_swapped
from cosim.system import StartValue, System, with_parameters
from fmus_src.component import Component
from fmus_src.units import unit
from tests.conftest import Outcome

from .foreign_damper import NAMES, foreign_damper

RULES = [NameRule(ours, theirs) for ours, theirs in NAMES.items()]
SSM = "http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


@pytest.fixture(scope="module")
def theirs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return foreign_damper(tmp_path_factory.mktemp("foreign"))


@pytest.fixture(scope="module")
def system() -> System:
    return prepare(read_case("decay10"), "mtmd", Changes(), quiet=True).system


def ssm(path: Path, **attributes: str) -> Path:
    entries = "".join(
        f'<ssm:MappingEntry source="nacelle_damper.{a}" target="{b}">{attributes.get(b, "")}</ssm:MappingEntry>'
        for a, b in NAMES.items()
    )
    path.write_text(f'<ssm:ParameterMapping xmlns:ssm="{SSM}" xmlns:ssc="{SSC}" version="1.0">{entries}'
                    "</ssm:ParameterMapping>")  # fmt: skip
    return path


def test_a_damper_in_other_names_and_units_moves_the_same(theirs: Path, tmp_path: Path) -> None:
    """10 deg decay for 8 s, both end stops hit. The other's Runge-Kutta steps of 2 ms do not locate the impacts.

    An impact found up to 2 ms late errs by about 1e-3 of the stop's force, which lasts a tenth of a second: 1e-3 of
    the travel. What the swap could do wrong (a factor, a sign, a wrong name) is of the order of one.
    """
    changes = Changes(swap=(f"nacelle_damper={theirs}",), map=(str(ssm(tmp_path / "names.ssm")),), until=8.0)
    usual = prepare(read_case("decay10"), "mtmd", Changes(until=8.0), quiet=True)
    swapped = prepare(read_case("decay10"), "mtmd", changes, quiet=True)
    ours = simulate(usual.system, usual.settings, tmp_path / "ours").frame()
    other = simulate(swapped.system, swapped.settings, tmp_path / "other").frame()
    assert list(other.columns) == list(ours.columns)  # travel in m, from an FMU that has mm
    assert ours["NStC1_XQ"].abs().max() > 8.0
    for channel in ("PtfmPitch", "TTDspFA", "TwrBsMyt", "NStC1_XQ", "NStC1_XQD"):
        difference = np.sqrt(((other[channel] - ours[channel]) ** 2).mean()) / ours[channel].std()
        assert difference < 2e-3, channel
    start = json.loads((tmp_path / "other/run.json").read_text())["components"]["nacelle_damper"]["start"]
    assert start["stiffness"] == pytest.approx(7.653, rel=1e-12)  # N/m in the case
    assert start["stroke"] == pytest.approx(8000.0, rel=1e-12)  # same name, other unit


def test_either_name_sets_a_parameter(system: System, theirs: Path) -> None:
    """By the system's name in the system's unit, by the FMU's own in the FMU's; a given unit is always converted."""
    swapped = with_swapped(system, "nacelle_damper", theirs, RULES)

    def stiffness(**values: object) -> object:
        named = {n.replace("__", "."): v for n, v in values.items()}
        at = swapped.components.index(swapped.component("nacelle_damper"))
        return check(with_parameters(swapped, named)).start[at]["stiffness"]  # type: ignore[arg-type]

    assert stiffness(nacelle_damper__k=5000.0) == pytest.approx(5.0)
    assert stiffness(nacelle_damper__stiffness=5.0) == 5.0
    assert stiffness(nacelle_damper__k=StartValue(5.0, unit("kN/m"))) == pytest.approx(5.0)
    assert stiffness(nacelle_damper__stiffness=StartValue(5000.0, unit("N/m"))) == pytest.approx(5.0)


def test_factors_of_a_mapping_turn_signs_and_scales(system: System, theirs: Path, tmp_path: Path) -> None:
    """The FMU's F_x = -2 force[1]: the connection to the barge divides by that; its input gets factor and offset."""
    path = ssm(
        tmp_path / "names.ssm", F_x='<ssc:LinearTransformation factor="-2"/>',
        a_x='<ssc:LinearTransformation factor="3" offset="5"/>',
    )  # fmt: skip
    entries = read_mapping(path)
    rules = [NameRule(e.source.removeprefix("nacelle_damper."), e.target, e.factor, e.offset) for e in entries]
    links = check(with_swapped(system, "nacelle_damper", theirs, rules)).links
    (force,) = (k for k in links if k.output.name == "F_x")
    (acceleration,) = (k for k in links if k.input.name == "a_x")
    assert force.factor == pytest.approx(-500.0)  # kN to N, halved
    assert (acceleration.factor, acceleration.offset) == pytest.approx((3000.0, 5.0))  # m/s2 to mm/s2
    with pytest.raises(CosimError, match=r"map nacelle_damper.force\[1\]: an output takes a factor only"):
        with_swapped(system, "nacelle_damper", theirs, [*RULES, NameRule("force[1]", "F_x", 1.0, 2.0)])


def test_what_an_fmu_lacks_can_be_left_out(system: System, theirs: Path) -> None:
    """'-' and wild cards: the barge's inputs then keep their start values, and the run says so."""
    rules = [r for r in RULES if not r.variable.startswith(("moment", "attachment.angular"))]
    rules += [NameRule("moment*", "-"), NameRule("attachment.angular*", "-")]
    swapped = with_swapped(system, "nacelle_damper", theirs, rules)
    ends = [c for c in swapped.connections if "nacelle_damper" in (c.source, c.target)]
    assert len(ends) == 6
    assert "gives nothing to barge.nacelle_damper.moment[1]" in swapped.notes[-1]
    assert not any("barge: not connected" in w and "nacelle_damper.moment" in w for w in check(swapped).warnings)


MISTAKES = [
    ((), "nacelle_damper: foreign_damper.fmu has no variable 'attachment.angular_acceleration[1]'; there are 'a_x',"),
    ((), "nor 'attachment.angular_acceleration[2]'"),
    ((), "map each with --map nacelle_damper.attachment.angular_acceleration[1]=NAME"),
    (("nacelle_damper.force[1]=F_xx",), "has no variable 'F_xx'; did you mean 'F_x'?"),
    (("nacelle_damper.forces[1]=F_x",), "the system has no such variable; did you mean 'force[1]'?"),
    (("nacelle_dampr.force[1]=F_x",), "no component 'nacelle_dampr'; did you mean 'nacelle_damper'?"),
    (("platform_damper.force[1]=F_x",), "--map platform_damper.force[1]: add --swap platform_damper=FILE.fmu"),
    (("nacelle_damper.force[1]",), "write it as COMPONENT.NAME=NAME, or FILE.ssm"),
    (("lost.ssm",), "lost.ssm: cannot be read (no such file)"),
]


@pytest.mark.parametrize(("maps", "words"), MISTAKES)
def test_mistakes_in_a_mapping_get_one_line(theirs: Path, maps: tuple[str, ...], words: str) -> None:
    changes = Changes(swap=(f"nacelle_damper={theirs}",), map=maps)
    with pytest.raises(CosimError) as refused:
        prepare(read_case("decay10"), "mtmd", changes, quiet=True)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_damper_in_python_by_pythonfmu_moves_the_same(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    """The same names, but no units and no saving of state: values are taken in the system's units.

    Steps are then not halved at the end stop, which is hit within 3 s: 1 % of the travel (docs/coupling.md).
    """
    pytest.importorskip("pythonfmu")
    source = Path(__file__).parents[1] / "benchmarks/tmd_slave.py"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    words = [sys.executable, "-m", "pythonfmu", "build", "-f", str(source), "-d", str(tmp_path)]
    subprocess.run(words, check=True, capture_output=True, env=environment)
    fmu = tmp_path / "PythonTmd.fmu"
    assert read_fmu(fmu).variables["k"].unit is None
    words = ["run", "decay10", "--damper", "mtmd", "--until", "3", "--energy-tolerance", "0"]
    assert fowt(*words, "--out", "ours").code == 0
    # in a process of its own: an embedded interpreter in this one would be another test's concern
    swapped = fowt(*words, "--swap", f"nacelle_damper={fmu}", "--isolate", "nacelle_damper", "--out", "theirs")
    assert swapped.code == 0, swapped.err
    assert "nacelle_damper: no unit where the other end has one" in swapped.err
    ours, other = (pd.read_parquet(tmp_path / n / "results.parquet") for n in ("ours", "theirs"))
    assert np.abs(other["NStC1_XQ"] - ours["NStC1_XQ"]).max() < 0.01 * ours["NStC1_XQ"].abs().max()


def test_a_missing_variable_is_named_with_the_nearest_match(system: System, built: Callable[[Component], Path]) -> None:
    c = Component("misspelt", "A damper with one name wrong")
    for name in ("specific_force", "angular_velocity", "angular_accelerations"):
        c.input(f"attachment.{name}", 3, description=name)
    for name in ("force", "moment"):
        c.output(name, ca.SX.zeros(3), description=name)
    with pytest.raises(CosimError, match=r"'attachment.angular_acceleration\[1\]'; did you mean 'attachment.angular_a"):
        with_swapped(system, "nacelle_damper", built(c))
