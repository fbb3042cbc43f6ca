# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Draws the histogram of latencies as SVG."""

from math import log

from valve_control.dashboard.latency import Histogram

WIDTH, HEIGHT, FOOT = 420, 150, 18  # px
TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # ms


def histogram_svg(histogram: Histogram) -> str:
    """SVG of ``histogram``; the heights go with the square root, so that rare late ones are seen."""
    largest = max(1, int(histogram.counts.max())) ** 0.5
    count = len(histogram.counts)
    step = WIDTH / count
    bars = "".join(
        f'<rect x="{i * step:.1f}" y="{HEIGHT - h:.1f}" width="{step - 1:.1f}" height="{h:.1f}"/>'
        for i, number in enumerate(histogram.counts)
        if (h := HEIGHT * (int(number) ** 0.5) / largest) > 0.0
    )
    low, high = histogram.borders[0], histogram.borders[-1]
    texts = ""
    for tick in TICKS:
        share = _share(tick, float(low), float(high))
        anchor = "start" if tick == TICKS[0] else "end" if tick == TICKS[-1] else "middle"
        word = f"{tick:g} ms" if tick == TICKS[-1] else f"{tick:g}"
        texts += f'<text x="{share * WIDTH:.0f}" y="{HEIGHT + FOOT - 4}" text-anchor="{anchor}">{word}</text>'
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT + FOOT}" width="100%" font-size="11" fill="#0072b2" '
        f'role="img" aria-label="latency in ms, median {histogram.p50:.3f}">{bars}{texts}</svg>'
    )


def _share(value: float, low: float, high: float) -> float:
    return log(value / low) / log(high / low)
