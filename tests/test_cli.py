"""The command line as a new user meets it: what it prints, what it leaves, and one clear line for every mistake."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.case import case_folder, read_case
from cosim.errors import CosimError
from fmus_src.component import Component
from fmus_src.tmd.model import declare_unit
from tests.conftest import Outcome

SHORT = ("--until", "2")


def test_run_leaves_results_statistics_provenance_and_a_picture(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    outcome = fowt(
        "run", "decay5", "--until", "20", "--damper", "mtmd", "--record", "barge.platform.*", "--out", "first"
    )
    assert outcome.code == 0
    assert "PtfmPitch" in outcome.out
    assert {p.name for p in (tmp_path / "first").iterdir()} == {
        "results.parquet", "summary.json", "run.json", "run.png",
    }  # fmt: skip
    provenance = json.loads((tmp_path / "first/run.json").read_text())
    assert provenance["status"] == "completed"
    assert re.fullmatch("[0-9a-f]{64}", provenance["components"]["barge"]["sha256"])
    again = fowt("run", "decay5", "--until", "20", "--out", "first")
    assert again.code == 1
    assert "nothing is overwritten" in again.err


def test_json_is_one_object_on_stdout(fowt: Callable[..., Outcome]) -> None:
    ran = json.loads(fowt("run", "decay5", *SHORT, "--format", "json").out)
    assert set(ran) == {"folder", "status", "summary"}
    assert set(ran["summary"]["PtfmPitch"]) == {"unit", "mean", "std", "rms", "min", "max"}
    listed = json.loads(fowt("list", "--format", "json").out)
    assert {"lc1", "lc5", "decay5"} <= set(listed["cases"])
    built = json.loads(fowt("build", "tmd", "--format", "json").out)
    assert Path(built["tmd"]).exists()


def test_optimise_then_run_with_the_tuned_set(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    words = ("--population", "20", "--generations", "3", "--out", "tuned", "--format", "json")
    tuned = json.loads(fowt("optimise", "tmd-p", *words).out)
    assert {"fitness", "parameters", "evaluations", "generations", "seconds"} <= set(tuned)
    assert json.loads((tmp_path / "tuned/result.json").read_text())["fitness"] == tuned["fitness"]
    ran = fowt("run", "decay5", "--damper", "tmd-p", "--ssv", "tuned/tuned.ssv", *SHORT, "--out", "run")
    assert ran.code == 0
    used = json.loads((tmp_path / "run/run.json").read_text())["components"]["platform_damper"]["start"]
    assert used["k"] == pytest.approx(tuned["parameters"]["platform_damper.k"])
    simplified = fowt("run", "decay5-simplified", "--damper", "tmd-p", "--ssv", "tuned/tuned.ssv", *SHORT)
    assert simplified.code == 0


def test_compare_runs_and_compares(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    words = ("--dampers", "none,mtmd", "--until", "40", "--channels", "PtfmPitch,TTDspFA", "--out", "both")
    compared = fowt("compare", "decay10", *words)
    assert compared.code == 0, compared.err
    assert "suppression" in compared.out
    assert (tmp_path / "both/comparison.png").stat().st_size > 10_000
    again = json.loads(fowt("compare", "both/none", "both/mtmd", "--channels", "PtfmPitch", "--format", "json").out)
    damped = next(r for r in again["table"] if r["run"] == "mtmd")
    assert damped["suppression"] > 20.0


def test_swapped_damper_is_used(
    fowt: Callable[..., Outcome], built: Callable[[Component], Path], tmp_path: Path
) -> None:
    stiff = Component("stiff_damper", "A damper with other defaults")
    declare_unit(stiff, "", mass=20_000.0, stiffness=5e5, damping=1e3, stroke=8.0)
    words = ("run", "decay10", "--until", "30", "--damper", "mtmd", "--out")
    assert fowt(*words, "usual").code == 0
    swapped = fowt(*words, "swapped", "--swap", f"nacelle_damper={built(stiff)}", "--set", "nacelle_damper.k=5e5")
    assert swapped.code == 0, swapped.err
    travel = [json.loads((tmp_path / n / "summary.json").read_text())["NStC1_XQ"]["std"] for n in ("usual", "swapped")]
    assert travel[1] < 0.1 * travel[0]


def _text_file(folder: Path, name: str, text: str) -> str:
    (folder / name).write_text(text)
    return str(folder / name)


SSV = """<?xml version="1.0"?><ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
version="1.0" name="x"><ssv:Parameters><ssv:Parameter name="nacelle_damper.k"><ssv:Real value="1" unit="{}"/>
</ssv:Parameter></ssv:Parameters></ssv:ParameterSet>"""

MTMD = ("run", "lc4", "--damper", "mtmd", *SHORT)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "lc44"), "no load case 'lc44'; did you mean 'lc4'?"),
        (("run", "lc4", "--damper", "mtdm"), "no damper arrangement 'mtdm'; did you mean 'mtmd'?"),
        ((*MTMD, "--set", "nacele_damper.k=1"), "no component 'nacele_damper'; did you mean 'nacelle_damper'?"),
        ((*MTMD, "--set", "nacelle_damper.stifness=1"), "no variable 'stifness' in tmd.fmu"),
        ((*MTMD, "--set", "nacelle_damper.k=-1"), "nacelle_damper.k = -1: -1 N/m is below its minimum 0"),
        ((*MTMD, "--set", "nacelle_damper.k"), "write it as COMPONENT.PARAM=VALUE"),
        ((*MTMD, "--swap", "nacelle_damper=nowhere.fmu"), "FMU nowhere.fmu: No such file"),
        ((*MTMD, "--swap", "nacelle_damper={corrupt}"), "cannot be read (File is not a zip file)"),
        ((*MTMD, "--ssv", "{wrong_unit}"), "'kg' cannot be converted to 'N/m'"),
        ((*MTMD, "--ssv", "{no_unit}"), "unknown unit 'furlong'"),
        ((*MTMD, "--set", "aero.wind_file=nowhere.bts"), "wind file 'nowhere.bts': cannot be opened"),
        ((*MTMD, "--set", "aero.wind_file={corrupt}"), "is shorter than a .bts header"),
        ((*MTMD, "--out", "{corrupt}/below"), "Not a directory"),
        (("run", "decay10", "--rate", "hydro=x"), "'x' is no number; write it as COMPONENT=2 or COMPONENT=1/2"),
        (("run", "decay10", "--algorithm", "newto"), "no algorithm 'newto'; did you mean 'newton'"),
        (("run", "lc4", "--until", "-1"), "stop -1 s must be finite and after start 0 s"),
        (
            ("run", "lc4", "--until", "60", "--step", "5", "--energy-tolerance", "0"),
            "the step is larger than the case's 0.0125 s",
        ),
        (("run", "{bad_case}"), "unknown key 'dampr'; did you mean 'damper'?"),
        (("build", "tdm"), "no component 'tdm'; did you mean 'tmd'?"),
        (("optimise", "mtdm"), "did you mean 'mtmd'?"),
        (("compare", "lc4", "lc5"), "'lc4' is no folder of a run"),
        (("optimise", "mtmd", "--generations", "0"), "Invalid value for '--generations'"),
    ],
)
def test_a_mistake_gets_one_line(
    fowt: Callable[..., Outcome], tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    files = {
        "corrupt": _text_file(tmp_path, "corrupt.fmu", "not an archive"),
        "wrong_unit": _text_file(tmp_path, "wrong.ssv", SSV.format("kg")),
        "no_unit": _text_file(tmp_path, "none.ssv", SSV.format("furlong")),
        "bad_case": _text_file(
            tmp_path, "bad.toml",
            'description = "x"\nsystem = "s.ssd"\nchannels = "c.toml"\ndampers = "d.toml"\ndampr = "none"\n'
            "[run]\nstop = 1.0\n",
        ),
    }  # fmt: skip
    _text_file(tmp_path, "d.toml", "[none]\n")
    outcome = fowt(*(w.format(**files) for w in words))
    lines = [line for line in outcome.err.splitlines() if line.startswith("error:")]
    assert outcome.code in (1, 2)
    assert len(lines) == 1
    assert message in lines[0]
    assert "Traceback" not in outcome.err


def test_not_a_number_from_a_component_stops_the_run_and_keeps_it(
    fowt: Callable[..., Outcome], built: Callable[[Component], Path], tmp_path: Path
) -> None:
    """A damper that overflows after a while: the message names it, and what was computed until then is there."""
    c = Component("runaway_damper", "A damper whose state overflows")
    declare_unit(c, "", mass=20_000.0, stiffness=6302.0, damping=1598.0, stroke=8.0)
    rate = c.parameter("rate", 100.0, unit="1/s", description="growth")
    runaway = c.state("runaway", description="grows without bound", start=1.0)
    c.derivative(runaway, rate * runaway)
    outcome = fowt("run", "decay10", "--swap", f"nacelle_damper={built(c)}", "--until", "20", "--out", "kept")
    assert outcome.code == 1
    assert re.search(r"nacelle_damper.* state runaway = inf at 7\.\d+ s", outcome.err)
    import pandas as pd

    kept = pd.read_parquet(tmp_path / "kept/results.parquet")
    assert kept["Time"].iloc[-1] > 6.0
    assert json.loads((tmp_path / "kept/run.json").read_text())["status"] == "failed"


def test_help_shows_an_example(fowt: Callable[..., Outcome]) -> None:
    for command in ("build", "run", "compare", "optimise", "verify", "list"):
        assert "fowt " + command in fowt(command, "--help").out.replace("Usage: fowt " + command, "")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("seed_parameters = [3]", "'seed_parameters' holds 3; it should hold names in quotes"),
        ('without = "aero"', "'without' = 'aero' should be a list"),
        ("[parameters]\nhydro.Hs = [4]", "parameters: hydro.Hs = [4] is no value"),
    ],
)
def test_a_mistake_in_a_load_case_gets_one_line(tmp_path: Path, line: str, message: str) -> None:
    _text_file(tmp_path, "d.toml", "[none]\n")
    head = 'description = "x"\nsystem = "s.ssd"\nchannels = "c.toml"\ndampers = "d.toml"\n'
    run = "[run]\nstop = 1.0\n"
    text = head + (f"{run}{line}\n" if line.startswith("[") else f"{line}\n{run}")
    path = _text_file(tmp_path, "case.toml", text)
    with pytest.raises(CosimError) as caught:
        read_case(str(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_copy_of_a_case_runs_from_any_folder(tmp_path: Path) -> None:
    """What it names is the package's, unless a file of that name lies beside it."""
    text = (case_folder() / "lc4.toml").read_text(encoding="utf-8")
    path = _text_file(tmp_path, "my own.toml", text)
    copy, shipped = read_case(str(path)), read_case("lc4")
    assert (copy.system, copy.channels, copy.dampers) == (shipped.system, shipped.channels, shipped.dampers)
    own = Path(_text_file(tmp_path, "channels.toml", ""))
    _text_file(tmp_path, "dampers.toml", '[mine]\nparameters = "mtmd.ssv"\n')
    copy = read_case(str(path))
    assert (copy.channels, copy.dampers["mine"].parameters) == (own, case_folder() / "mtmd.ssv")


def test_names_of_parameters_need_no_quotes(tmp_path: Path) -> None:
    _text_file(tmp_path, "d.toml", "[none]\n")
    head = 'description = "x"\nsystem = "s.ssd"\nchannels = "c.toml"\ndampers = "d.toml"\n[run]\nstop = 1.0\n'
    path = _text_file(tmp_path, "case.toml", head + '[parameters]\nhydro.Hs = 4.0\n"aero.wind_file" = "x.bts"\n')
    assert read_case(str(path)).parameters == {"hydro.Hs": 4.0, "aero.wind_file": "x.bts"}


def test_converge_shows_errors_and_orders(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    """Against the same system as one ODE: the 10 deg decay, whose dampers are not at their stops yet."""
    words = ("converge", "decay10", "--damper", "mtmd", "--until", "4", "--step", "0.05", "--halvings", "1")
    outcome = fowt(*words, "--out", "study", "--format", "json")
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    errors = {(r["scheme"], r["step"]): r["error"] for r in found["table"]}
    assert errors["gauss-seidel, linear", 0.025] < 0.3 * errors["gauss-seidel, linear", 0.05]
    assert errors["gauss-seidel, linear", 0.05] < 0.5 * errors["gauss-seidel, held", 0.05]
    assert errors["newton, halved", 0.05] < 1e-5
    assert found["orders"]["gauss-seidel, linear"] > 1.8
    assert (tmp_path / "study" / "convergence.png").stat().st_size > 10_000
    assert (tmp_path / "study" / "convergence.csv").read_text().startswith("scheme,step,error,order,PtfmPitch")
