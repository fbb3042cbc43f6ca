# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's table from offline runs, beside its figures; `make paper` does it through the nodes."""

import json

import numpy as np
import pytest

from research.paper import PAPER_TABLE_1
from research.paper.__main__ import main


def test_table_1_is_reproduced(tmp_path):
    """All fifteen numbers within 5 %, rms log error at most 0.03, and the paper's orders.

    One pair is not in its order: u_rms of PID and OARC, which the paper has 0.04 % apart and we 1 % (README).
    """
    assert main(["--offline", "--out", str(tmp_path)]) == 0
    table = json.loads((tmp_path / "table1.json").read_text())
    ratios = []
    for name, paper in PAPER_TABLE_1.items():
        for index, reference in paper._asdict().items():
            assert table[name]["paper"][index] == reference
            assert table[name]["ratio"][index] == pytest.approx(table[name]["indices"][index] / reference)
            ratios.append(table[name]["ratio"][index])
    assert table["rms_log_error"] == pytest.approx(np.sqrt(np.mean(np.log(ratios) ** 2)))
    assert np.max(np.abs(np.array(ratios) - 1.0)) <= 0.05
    assert table["rms_log_error"] <= 0.03
    assert {index for index, kept in table["orders_kept"].items() if not kept} <= {"u_rms"}
    assert table["pid"]["indices"]["u_rms"] == pytest.approx(table["oarc"]["indices"]["u_rms"], rel=0.01)
    assert table["arc"]["indices"]["u_rms"] > table["pid"]["indices"]["u_rms"]
