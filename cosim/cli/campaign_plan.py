"""A campaign's plan: what it consists of, what of it is done, and what is there from earlier commands."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cosim.archive import sha256
from cosim.campaign.store import RUNS, Outcome, Task
from cosim.case import LoadCase, shipped_cases
from cosim.errors import CosimError
from cosim.recording import versions, write_json
from optimisation.campaign.runs import PLAN, run_name

CASES, DAMPERS = ("lc1", "lc2", "lc3", "lc4", "lc5"), "none,tmd-n,tmd-p,mtmd"
SEEDS = "2:7"  # with seed 1 the rotor of LC4 and LC5 sways out of its wind box


@dataclass(frozen=True)
class Options:
    """What a campaign consists of; all that its results follow from, besides FMUs and versions."""

    cases: tuple[str, ...] = CASES
    dampers: tuple[str, ...] = tuple(DAMPERS.split(","))
    seeds: tuple[int, ...] = tuple(range(2, 8))
    ssv: tuple[str, ...] = ()
    set: tuple[str, ...] = ()
    until: float | None = None


@dataclass(frozen=True)
class Earlier:
    """What a folder's plan says of the commands before this one; empty in a new folder.

    Attributes:
        commands: that were given. cases: file or name of each load case, by its name. dampers: arrangements, in order.
        runs: case, arrangement and seed of each run that was planned, by its label.
    """

    commands: tuple[str, ...] = ()
    cases: Mapping[str, str] = field(default_factory=dict)
    dampers: tuple[str, ...] = ()
    runs: Mapping[str, tuple[str, str, int]] = field(default_factory=dict)

    @classmethod
    def read(cls, root: Path) -> Earlier:
        """Raises CosimError: the plan cannot be read."""
        if not (root / PLAN).exists():
            return cls()
        try:
            saved = json.loads((root / PLAN).read_text(encoding="utf-8"))
            runs = [(r["case"], r["damper"], int(r["seed"])) for r in saved["runs"]]
            cases = {name: str(content.get("given", name)) for name, content in saved["cases"].items()}
            commands = tuple(saved.get("commands", (saved["command"],)))
            return cls(commands, cases, tuple(saved["dampers"]), {run_name(*r): r for r in runs})
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise _unreadable(root, error) from error


def in_order(tasks: Sequence[Task], earlier: Earlier) -> list[Task]:
    """Tasks by load case, arrangement and seed, as if one command had named them all."""
    cases = list(dict.fromkeys([*earlier.cases, *(t.about["case"] for t in tasks)]))
    dampers = list(dict.fromkeys([*earlier.dampers, *(t.about["damper"] for t in tasks)]))
    return sorted(
        tasks, key=lambda t: (cases.index(t.about["case"]), dampers.index(t.about["damper"]), t.about["seed"])
    )


def made_plan(
    options: Options, cases: Mapping[str, LoadCase], tasks: Sequence[Task], commands: Sequence[str], root: Path
) -> dict[str, Any]:
    """Content of campaign.json, see docs/campaign.md, before anything has run.

    Args:
        options: of this command. tasks: all runs, those of earlier commands too. commands: that these came from.
    """
    by_case = {t.about["case"]: t.job.settings for t in tasks}
    folder = shlex.quote(root.name)
    return {
        "command": commands[0] if len(commands) == 1 else " && ".join(f"{c} --out {folder}" for c in commands),
        "commands": list(commands),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "options": asdict(options) | {"ssv_sha256": _ssv_digests(options)},
        "cases": {
            name: {
                "given": _given(cases[name]), "description": cases[name].description,
                "wind_speed": wind.mean_speed if (wind := cases[name].wind) else None,
                "stop": by_case[name].stop, "step": by_case[name].step, "transient": by_case[name].transient,
            }
            for name in by_case
        },
        "dampers": list(dict.fromkeys(t.about["damper"] for t in tasks)),
        "seeds": list(dict.fromkeys(t.about["seed"] for t in tasks)),
        "runs": [
            {**{k: t.about[k] for k in ("case", "damper", "seed")}, "folder": f"{RUNS}/{t.label}", "key": t.key}
            for t in tasks
        ],
        "versions": versions(),
        "table_sha256": None,
    }  # fmt: skip


def _given(case: LoadCase) -> str:
    """What `read_case` finds a case by from any folder."""
    return case.name if shipped_cases().get(case.name) == case.file else str(case.file.absolute())


def command(options: Options) -> str:
    """The command that makes this campaign anywhere, however it was taken up here."""
    words = ["fowt", "campaign", *options.cases, "--dampers", ",".join(options.dampers)]
    words += ["--seeds", ",".join(map(str, options.seeds))]
    words += [w for path in options.ssv for w in ("--ssv", Path(path).name)]
    words += [w for item in options.set for w in ("--set", item)]
    return shlex.join(words if options.until is None else [*words, "--until", f"{options.until:g}"])


def write_plan(root: Path, plan: dict[str, Any], outcomes: Mapping[str, Outcome]) -> None:
    """Write a plan with how far each of its runs is."""
    for run in plan["runs"]:
        outcome = outcomes.get(run["folder"].removeprefix(f"{RUNS}/"))
        run["status"] = "waiting" if outcome is None else "failed" if outcome.error else "done"
        run["message"] = outcome.error if outcome else ""
    write_json(root / PLAN, plan)


def begun(root: Path) -> Options:
    """Options of the campaign in a folder.

    Raises:
        CosimError: there is none.
    """
    try:
        saved = json.loads((root / PLAN).read_text(encoding="utf-8"))["options"]
        cases, dampers, seeds, ssv, values = (tuple(saved[k]) for k in ("cases", "dampers", "seeds", "ssv", "set"))
        return Options(cases, dampers, seeds, ssv, values, saved["until"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CosimError(f"--resume {root}: holds no campaign (no readable {PLAN}); begin one with --out") from error


def refuse_another(root: Path, options: Options) -> None:
    """More cases, arrangements or seeds extend a campaign; other parameters are another one.

    Raises:
        CosimError: the folder has a campaign with other parameters.
    """
    if not (root / PLAN).exists():
        return
    try:
        saved = json.loads((root / PLAN).read_text(encoding="utf-8"))["options"]
        there = {"--set": saved["set"], "--until": saved["until"], "--ssv": saved["ssv_sha256"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _unreadable(root, error) from error
    wanted = {"--set": list(options.set), "--until": options.until, "--ssv": _ssv_digests(options)}
    for name, value in wanted.items():
        if value != there[name]:
            has = "another content" if name == "--ssv" else there[name] or "none"
            raise CosimError(f"{root}: its campaign was begun with another {name} ({has}); choose another --out")


def _unreadable(root: Path, error: Exception) -> CosimError:
    return CosimError(f"{root / PLAN}: cannot be read ({type(error).__name__}); choose another --out")


def _ssv_digests(options: Options) -> list[str]:
    return [sha256(Path(p)) for p in options.ssv]
