"""Statistics, suppression rate and spectra of signals whose values are known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from optimisation.evaluation import compare, power_spectral_density, statistics, suppression_rate

TIME = 0.0125 * np.arange(50_401)  # 630 s


def test_statistics_of_a_sine_after_the_transient() -> None:
    x = 2.0 + 3.0 * np.sin(2 * np.pi * 0.1 * TIME)
    x[TIME < 29.99] = 1e3  # start-up, to be dropped
    found = statistics(TIME, x)
    # 60 whole periods, and one sample more: 1e-4
    assert found.mean == pytest.approx(2.0, abs=1e-4)
    assert found.std == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-4)
    assert found.rms == pytest.approx(np.sqrt(4.0 + 4.5), rel=1e-4)
    assert (found.min, found.max) == pytest.approx((-1.0, 5.0), abs=1e-6)


def test_suppression_rate() -> None:
    assert suppression_rate(0.5220, 0.3863) == pytest.approx(26.0, abs=0.01)
    assert suppression_rate(1.0, 1.1) == pytest.approx(-10.0)
    with pytest.raises(ValueError, match="above 0"):
        suppression_rate(0.0, 1.0)


def test_spectrum_holds_the_variance_and_shows_the_peak() -> None:
    rng = np.random.default_rng(3)
    x = 5.0 + 2.0 * np.sin(2 * np.pi * 0.085 * TIME) + rng.normal(0.0, 0.5, TIME.size)
    found = power_spectral_density(TIME, x)
    assert found.segment == pytest.approx(200.0)
    assert found.segments == 5
    resolution = found.frequency[1]
    assert resolution == pytest.approx(1 / 200.0)
    assert found.frequency[np.argmax(found.density)] == pytest.approx(0.085, abs=resolution / 2)
    # Parseval; the estimate of the noise's part scatters by a few per mille
    assert found.density.sum() * resolution == pytest.approx(2.0 + 0.25, rel=0.01)
    # white noise of variance s2 is s2 / f_Nyquist everywhere
    band = (found.frequency > 1.0) & (found.frequency < 39.0)
    assert found.density[band].mean() == pytest.approx(0.25 / 40.0, rel=0.02)


def test_comparison_of_runs() -> None:
    wave = np.sin(2 * np.pi * 0.1 * TIME)
    index = pd.Index(TIME, name="time")
    runs = {
        "none": pd.DataFrame({"TTDspFA": wave, "GenPwr": 5000.0}, index=index),
        "mtmd": pd.DataFrame({"TTDspFA": 0.7 * wave, "GenPwr": 4990.0}, index=index),
    }
    table = compare(runs, ["TTDspFA", "GenPwr"])
    assert table.loc[("TTDspFA", "mtmd"), "suppression"] == pytest.approx(30.0)
    assert table.loc[("TTDspFA", "none"), "suppression"] == 0.0
    assert table.loc[("GenPwr", "mtmd"), "mean"] == pytest.approx(4990.0)
    assert np.isnan(table.loc[("GenPwr", "mtmd"), "suppression"])  # no fluctuation to suppress
    with pytest.raises(ValueError, match="has no channel 'PtfmPitch'"):
        compare(runs, ["PtfmPitch"])
    with pytest.raises(ValueError, match="reference 'tmd' is none of"):
        compare(runs, ["TTDspFA"], reference="tmd")


def test_unusable_records_are_refused() -> None:
    with pytest.raises(ValueError, match="nothing left"):
        statistics(TIME[:100], TIME[:100])
    with pytest.raises(ValueError, match="equally spaced"):
        statistics(TIME**1.01, TIME)
    x = np.ones(TIME.size)
    x[-1] = np.nan
    with pytest.raises(ValueError, match="630 s is not finite"):
        statistics(TIME, x)
    with pytest.raises(ValueError, match="equally long"):
        statistics(TIME, x[:-1])
