"""The report of a campaign: pure functions from tables to figures, sentences and one self-contained page."""
