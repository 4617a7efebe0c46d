"""Exported sampling: instants, and the first sample."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fmus_src.component import Component
from fmus_src.instance import Instance

from .loaded import Loaded, initialised


def test_samples_at_every_instant_of_an_importer_that_adds_up_its_steps(
    built: Callable[[Component], Path], tmp_path: Path
) -> None:
    """After 100 000 sums of 0.05 s the importer's clock is short of the instant, by less than 1e-5 steps."""
    c = Component("counter", "Counts its samples", sample_time=0.05)
    z = c.sampled_state("z", description="number of samples")
    c.update(z, z + 1)
    fmu = Loaded(built(c), tmp_path)
    slave, twin, now, steps = initialised(fmu), Instance(c), 0.0, 100_000
    behind = 0.0
    for i in range(steps):
        slave.doStep(now, 0.05)
        now += 0.05
        behind = max(behind, (i + 1) * 0.05 - now)
        if i % 997 == 0:
            assert slave.getReal(fmu.vr("z")) == [i + 1]
    assert slave.getReal(fmu.vr("z")) == [steps]
    assert behind > 1e-9 * 0.05  # otherwise this tests nothing
    twin.initialise()
    twin._samples, twin.time = 79_999, 79_999 * 0.05 - 1e-8
    twin.do_step(0.05)
    assert twin._samples == 80_000
    slave.freeInstance()


def sampler(at_start: bool) -> Component:
    """Takes the input at each sample and counts the samples."""
    c = Component("sampler", "Sample and hold", sample_time=0.1, sample_at_start=at_start)
    u = c.input("u", description="input")
    held = c.sampled_state("held", start=-1.0, description="input at the last sample")
    count = c.sampled_state("count", internal=True, description="number of samples")
    twice = c.intermediate("twice", 2 * u)
    c.update(held, twice)
    c.update(count, count + 1)
    c.output("y", held, description="twice the input at the last sample")
    c.output("n", count, description="number of samples")
    return c


@pytest.mark.parametrize("at_start", [True, False])
def test_first_sample_is_at_the_start_or_a_period_later(
    built: Callable[[Component], Path], tmp_path: Path, at_start: bool
) -> None:
    """At the start it follows the inputs through initialisation, as often as they change, and counts once."""
    fmu, twin = Loaded(built(sampler(at_start)), tmp_path), Instance(sampler(at_start))
    slave, y = fmu.instance(), fmu.vr("y", "n")
    slave.setupExperiment(startTime=0.0)
    slave.setReal(fmu.vr("u"), [1.0])
    slave.enterInitializationMode()
    for u in (1.0, 3.0, 2.0):
        slave.setReal(fmu.vr("u"), [u])
        assert slave.getReal(y) == ([2 * u, 1.0] if at_start else [-1.0, 0.0])
    slave.setReal(fmu.vr("u"), [4.0])  # the last word, unread before the start
    slave.exitInitializationMode()
    twin.set({"u": 4.0})
    twin.initialise()
    for i in range(4):
        expected = [8.0 + 2 * (i // 2), i // 2 + 1.0] if at_start else [-1.0 if i < 2 else 8.0 + 2 * (i // 2), i // 2]
        assert slave.getReal(y) == expected
        assert [twin.get("y"), twin.get("n")] == expected
        slave.setReal(fmu.vr("u"), [4.0 + (i + 1) // 2])
        twin.set({"u": 4.0 + (i + 1) // 2})
        assert slave.getReal(y) == expected
        slave.doStep(0.05 * i, 0.05)
        twin.do_step(0.05)
    slave.freeInstance()
