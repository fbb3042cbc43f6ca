# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import re

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.analysis.figures import Line, Plot, Trace, draw_traces
from valve_control.control.analysis.page import envelope, figure, page, table
from valve_control.control.analysis.spectra import spectrum


def test_page_is_whole_and_loads_nothing():
    plot = Plot("error [V]", [Line("a", np.arange(10.0), np.arange(10.0))])
    text = page("report <1>", {"Figures": figure([plot], "time [s]"), "Table": table(["a"], [["<b>"]])})
    assert "<title>report &lt;1&gt;</title>" in text and "&lt;b&gt;" in text
    assert "Plotly.newPlot" in text
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.S)
    assert "http" not in outside
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)\s*=", text)


def test_a_large_error_does_not_hide_the_small_ones(tmp_path):
    time = np.linspace(0.0, 1.0, 100)
    runs = {name: Trace(time, time, time + size, time) for name, size in (("good", 0.01), ("bad", 0.1))}
    draw_traces([tmp_path / "both.svg"], runs, "title")
    text = (tmp_path / "both.svg").read_text()
    assert "<!-- small errors [mV] -->" in text and "<!-- bad: 100 mV rms, 10 % of stroke -->" in text
    assert {"#e69f00", "#882255"} <= set(re.findall(r"stroke: (#\w+)", text))  # laws of other packages


def test_spectrum_of_a_sine_stands_at_its_frequency_with_its_power():
    t = np.arange(60_000) * 0.001
    s = spectrum(0.3 * np.sin(2 * np.pi * 17.0 * t), 0.001)
    peak = s.frequency[np.argmax(s.density)]
    assert abs(peak - 17.0) < 0.25
    power = np.sum(s.density**2) * (s.frequency[1] - s.frequency[0])
    assert abs(power - 0.3**2 / 2) < 1e-4


@settings(max_examples=60, deadline=None)
@given(st.integers(1001, 30_000), st.integers(0, 2**32 - 1))
def test_envelope_of_a_line_with_gaps_keeps_extremes_and_gaps(count, seed):
    """A reading that is missing counted as 0 V, and hid the extreme of its neighbours."""
    random = np.random.default_rng(seed)
    y = 5.0 + random.standard_normal(count)
    y[random.random(count) < random.uniform(0.0, 0.5)] = np.nan
    begin = int(random.integers(0, count // 2))
    y[begin : begin + count // 4] = np.nan
    ex, ey = envelope(np.arange(float(count)), y, 1000)
    assert len(ex) <= 1000 and np.all(np.diff(ex) > 0)
    assert np.nanmax(ey) == np.nanmax(y) and np.nanmin(ey) == np.nanmin(y)
    inside = ey[(ex >= begin) & (ex < begin + count // 4)]
    assert np.isnan(inside).all() and len(inside)
