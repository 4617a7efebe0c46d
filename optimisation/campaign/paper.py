"""Figures that the text of Wang et al. (2022) gives, beside a campaign's."""

from __future__ import annotations

import tomllib
from importlib import resources

import pandas as pd

from optimisation.campaign.tables import levels, suppression

LARGEST = "largest"
CASES = ("lc1", "lc2", "lc3", "lc4", "lc5")


def paper_figures() -> pd.DataFrame:
    """What the paper's text gives: `quantity` ("suppression", "rms"), `case` ("largest": of all cases), `damper`,
    `channel`, `value` (%, kW), `says` ("about", "at least", "at most").
    """
    text = resources.files("optimisation.campaign").joinpath("paper.toml").read_text(encoding="utf-8")
    rows = [{"quantity": q, **figure} for q, part in tomllib.loads(text).items() for figure in part["figures"]]
    return pd.DataFrame(rows, columns=["quantity", "case", "damper", "channel", "value", "says"])


def beside_paper(table: pd.DataFrame) -> pd.DataFrame:
    """The paper's figures beside ours, where the campaign has the case and arrangement.

    Returns:
        `quantity`, `case`, `damper`, `channel`, `unit`, `paper`, `says`, `ours`, `half`, `low`, `high`, `seeds`,
        `within`: whether the paper's one realisation lies within our interval ("at least" V: whether V is not above
        it); None of one seed, which has no interval. What is the largest of the cases needs all five.
    """
    channels = list(dict.fromkeys(paper_figures()["channel"]))
    rates = suppression(table, channels).rename(columns={"rate": "value"}).assign(unit="%")
    ours = {"suppression": rates, "rms": levels(table, "rms", channels)}
    rows = []
    for figure in paper_figures().itertuples():
        found = ours[str(figure.quantity)]
        found = found[(found["damper"] == figure.damper) & (found["channel"] == figure.channel)]
        whole = set(CASES) <= set(found["case"])
        largest = found.nlargest(1, "value") if whole else found.iloc[:0]
        found = largest if figure.case == LARGEST else found[found["case"] == figure.case]
        if found.empty:
            continue
        own = found.iloc[0]
        above, below = figure.value > own["high"], figure.value < own["low"]
        within = not (above if figure.says == "at least" else below if figure.says == "at most" else above or below)
        rows.append({
            "quantity": figure.quantity, "case": figure.case, "damper": figure.damper, "channel": figure.channel,
            "unit": own["unit"], "paper": figure.value, "says": figure.says, "ours": own["value"],
            **{k: own[k] for k in ("half", "low", "high", "seeds")},
            "within": within if own["seeds"] > 1 else None,
        })  # fmt: skip
    names = ["quantity", "case", "damper", "channel", "unit", "paper", "says", "ours", "half", "low", "high", "seeds",
             "within"]  # fmt: skip
    return pd.DataFrame(rows, columns=names)
