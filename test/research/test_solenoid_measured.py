# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The table of the solenoid valves in the docs."""

from pathlib import Path

import pytest

from research import solenoid

ROOT = Path(__file__).parents[2]


def test_the_table_of_the_docs_is_that_of_the_command():
    found = {"d633": solenoid.measured(ROOT / "config" / "solenoid" / "d633.yaml")}
    head, rule, row = solenoid.table(found)
    text = (ROOT / "docs" / "explanation" / "valve_model.md").read_text(encoding="utf-8")
    assert f"{head}\n{rule}\n" in text and f"\n{row}\n" in text


def test_the_loop_has_the_width_of_magnet_and_friction_together():
    found = solenoid.measured(ROOT / "config" / "solenoid" / "d136.yaml")
    assert found.width == pytest.approx((0.1 + 2.0 * 0.04) / (1.0 + 0.05), rel=0.04)
    assert 50.0 < found.minus_90 < 70.0 and found.rise < 0.01
