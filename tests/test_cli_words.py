"""What all commands share: seeds, foreign names on the terminal, errors as JSON, options that need each other."""

from __future__ import annotations

import inspect
import io
import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from cosim.cli import app, console
from cosim.cli.campaign_view import evaluate_all, show
from cosim.cli.console import busy, count_progress, simulation_progress
from cosim.cli.seeds import parsed_seeds
from cosim.errors import CosimError
from fmus_src.component import Component
from optimisation.campaign.runs import Campaign, write_table

from .conftest import Outcome


@pytest.mark.parametrize(
    ("text", "seeds"),
    [("3", (3,)), ("1:6", (1, 2, 3, 4, 5, 6)), ("1,4,7", (1, 4, 7)), ("1:3,8", (1, 2, 3, 8)), (" 5 , 0:1", (5, 0, 1))],
)
def test_seeds_are_a_number_a_list_or_ranges(text: str, seeds: tuple[int, ...]) -> None:
    assert parsed_seeds(text) == seeds


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("6:1", "the range 6:1 runs backwards; write 1:6"),
        ("1:3,2", "seed 2 appears twice; name each once"),
        ("1,,2", "'' is no seed; write whole numbers from 0, as 3, 1:6 or 1,4,7"),
        ("-1", "'-1' is no seed"),
        ("1.5", "'1.5' is no seed"),
        ("1:2:3", "'1:2:3' is no seed"),
        ("1:9999999", "more than 10000 seeds"),
        ("2147483648", "a seed is at most 2147483647"),
    ],
)
def test_wrong_seeds_get_the_same_line_from_every_command(
    fowt: Callable[..., Outcome], text: str, message: str
) -> None:
    with pytest.raises(CosimError) as caught:
        parsed_seeds(text)
    assert message in str(caught.value)
    commands = (
        ("campaign", "lc1"), ("linearise", "lc1"), ("methods", "tmd-p"),
        ("optimise", "mtmd", "--objective", "coupled", "--cases", "lc1"),
    )  # fmt: skip
    for words in commands:
        assert fowt(*words, f"--seeds={text}") == Outcome(1, "", f"error: {caught.value}\n")


# ---- names from elsewhere: rich would take [red] for a colour, [/] for an error and :x: for a picture

STRANGE = "a[1][red]b[/red][/]:x:"


def _foreign_fmu(fmu: Path, path: Path) -> Path:
    """A copy of an FMU whose model, description and a variable have a strange name."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'name="slope"', f'name="{STRANGE}"'.encode())
                content = re.sub(rb'description="[^"]*"', f'description="{STRANGE}"'.encode(), content)
            new.writestr(name, content)
    return path


def _slope() -> Component:
    c = Component("slope_of_input", "integrates its input")
    slope = c.parameter("slope", 1.0, description="factor")
    x = c.state("x", description="integral")
    c.derivative(x, slope * c.input("u", description="input"))
    c.output("y", x, description="integral")
    return c


def test_foreign_names_are_printed_as_they_are(
    fowt: Callable[..., Outcome], built: Callable[[Component], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    file = _foreign_fmu(built(_slope()), tmp_path / "a[1][red]b:x:.fmu")
    inspected = fowt("inspect", file.name)
    assert inspected.code == 0, inspected.err
    for words in (f"{file.name}: FMI", STRANGE, f"{STRANGE}  "):
        assert words in inspected.out
    validated = fowt("validate", file.name)
    assert f"{file.name}: " in validated.out
    copied = fowt("build", "simplified", "--name", "a[1][red]b:x:", "--out", "[red]fmus")
    assert "[red]fmus/a[1][red]b:x:.fmu" in copied.out, copied.err
    ran = fowt("run", "decay5-simplified", "--until", "1", "--out", "a[1][red]:x:")
    assert "completed: a[1][red]:x: " in ran.out, ran.err
    fowt("run", "decay5-simplified", "--until", "1", "--damper", "mtmd", "--out", "b[red]")
    compared = fowt("compare", "a[1][red]:x:", "b[red]", "--channels", "PtfmPitch")
    assert re.search(r"standard deviation +a\[1\]\[red\]:x: +b\[red\] \(suppression\)", compared.out), compared.err


def test_foreign_names_in_a_campaign(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    rows = [
        {"case": STRANGE, "damper": damper, "seed": 1, "channel": "PtfmPitch", "unit": "deg", "std": std, "stroke": std}
        for damper, std in (("none", 2.0), ("x[red]", 1.0))
    ]
    found = Campaign(tmp_path / "c[1][red]", {"cases": {STRANGE: {}}}, write_table(rows, tmp_path / "runs.parquet"))
    show(found, evaluate_all(found))
    printed = capsys.readouterr().out
    assert len(re.findall(rf"^{re.escape(STRANGE)} +x\[red\] .*", printed, re.MULTILINE)) == 2  # rates, travel
    assert "c[1][red]: runs.parquet" in printed


def test_a_narrow_terminal_folds_the_figures_of_a_campaign_and_cuts_no_name(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Two seeds give wide intervals: cut short, tmd-n and tmd-p would be one."""
    monkeypatch.setenv("COLUMNS", "80")
    rows = [
        {"case": "decay10", "damper": d, "seed": s, "channel": c, "unit": "m", "std": 1.0 + s * share, "stroke": share}
        for c in ("PtfmPitch", "TTDspFA", "TwrBsMyt", "RootMyc1", "GenPwr")
        for s in (1, 2)
        for d, share in (("none", 0.0), ("tmd-n", 20.0), ("tmd-p", 21.0))
    ]
    found = Campaign(tmp_path / "c", {"cases": {"decay10": {}}}, write_table(rows, tmp_path / "runs.parquet"))
    show(found, evaluate_all(found))
    lines = capsys.readouterr().out.split("\nis the first better")[0].splitlines()
    names = [word for line in lines for word in line.split() if re.match("decay|tmd", word)]
    assert names == ["decay10", "tmd-n", "tmd-p"]
    assert not any("…" in line for line in lines)
    assert max(map(len, lines)) <= 80


def test_foreign_names_beside_progress_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    screen = Console(file=written, force_terminal=True, markup=False, emoji=False, width=200, color_system=None)
    monkeypatch.setattr(console, "err", screen)
    for made in (simulation_progress(False), count_progress(False)):
        made.live.transient = False
        with made as progress:
            progress.add_task(STRANGE, total=1.0, note=f"note {STRANGE}")
    with busy(STRANGE):
        pass
    assert len(re.findall(re.escape(STRANGE), written.getvalue())) >= 4


# ---- help


def test_help_fits_a_terminal_of_80_columns() -> None:
    """rich keeps the line ends of a docstring: a line that is too long would leave a word alone on the next."""
    for command in app.registered_commands:
        assert command.callback is not None
        text = re.sub(r"\[/?bold\]", "", inspect.getdoc(command.callback) or "")
        assert [line for line in text.split("\n\n", 1)[1].splitlines() if len(line) > 78] == []
        assert f"fowt {command.name} " in text, "no example"


# ---- errors for programs


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("build", "tdm"), 1), (("run", "lc9"), 1), (("export", "lc9"), 1), (("compare", "lc9"), 1),
        (("campaign", "lc9"), 1), (("converge", "lc9"), 1), (("identify", "--reference", "decay9"), 1),
        (("optimise", "mtdm"), 1), (("linearise", "lc9"), 1), (("map", "tmd"), 1), (("methods", "tmd"), 1),
        (("reproduce", "--section", "9"), 1), (("verify", "nothing"), 1), (("inspect", "no.fmu"), 1),
        (("validate", "no.fmu"), 1), (("run", "lc4", "--dampr", "mtmd"), 2), (("run",), 2), (("rum",), 2),
        (("list", "--all"), 2),
    ],
)  # fmt: skip
def test_a_program_that_reads_stdout_learns_why(
    fowt: Callable[..., Outcome], words: tuple[str, ...], code: int
) -> None:
    ended = fowt(*words, "--format", "json")
    assert ended.code == code
    error = json.loads(ended.out)
    assert list(error) == ["error"]
    assert f"error: {error['error']}" in ended.err
    assert fowt(*words, "--format=json").out == ended.out
    assert fowt(*words).out == ""


def test_a_stopped_command_says_so_to_programs_too(
    fowt: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cosim.cli.campaign._tasks", stop)
    ended = fowt("campaign", "lc1", "--format", "json")
    assert (ended.code, list(json.loads(ended.out))) == (130, ["error"])
    assert ended.err.startswith("warning: stopped by the user; ")
    monkeypatch.setattr("cosim.cli.listing.read_case", stop)
    ended = fowt("list", "--format", "json")
    assert ended == Outcome(130, '{\n  "error": "stopped by the user"\n}\n', "warning: stopped by the user\n")
