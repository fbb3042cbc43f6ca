# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Commands of an upper level of 100 Hz: where joining them helps, and where it does not."""

import re
from pathlib import Path

import pytest

from research import interpolation

DOCS = Path(__file__).parents[2] / "docs"
CASES = [(name, frequency) for name in interpolation.LAWS for frequency in interpolation.FREQUENCIES]


@pytest.mark.parametrize(("name", "frequency"), CASES)
def test_errors_and_lags_at_100_hz_are_those_of_the_table(name, frequency):
    """Of docs/howto/cascade.md: errors within 2 % and 1 mV, lags within 0.15 ms."""
    text = (DOCS / "howto" / "cascade.md").read_text(encoding="utf-8")
    made = interpolation.table({(name, frequency): interpolation.row(interpolation.LAWS[name], frequency)})
    assert made[0] in text
    (told,) = (row for row in text.splitlines() if row.startswith(f"| {name} | {frequency:.0f} Hz | "))
    there, here = (re.findall(r"(\d+) mV, (-?[\d.]+) ms", row) for row in (told, made[2]))
    assert len(there) == len(here) == 1 + len(interpolation.KINDS)
    for (error, lag), (other_error, other_lag) in zip(there, here, strict=True):
        assert float(error) == pytest.approx(float(other_error), rel=0.02, abs=1.0)
        assert float(lag) == pytest.approx(float(other_lag), abs=0.15)
