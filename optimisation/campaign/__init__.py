"""Evaluation of campaigns: load cases x damper arrangements x seeds, from one table and the folders of the runs.

`runs` turns a run into rows of the table and reads a campaign's folder; the other modules are pure functions.
"""
