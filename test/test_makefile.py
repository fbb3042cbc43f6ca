# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The status of `make test`, with a stand-in for pytest that leaves with given statuses."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PASSED, FAILED, INTERRUPTED, NONE_CHOSEN = 0, 1, 2, 5


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize(
    ("target", "statuses", "status"),
    [
        ("test", [PASSED, NONE_CHOSEN, NONE_CHOSEN], 0),
        ("test", [NONE_CHOSEN, NONE_CHOSEN, PASSED], 0),
        ("test", [PASSED, PASSED, PASSED], 0),
        ("test", [PASSED, FAILED, PASSED], 2),
        ("test", [FAILED, NONE_CHOSEN, NONE_CHOSEN], 2),
        ("test", [NONE_CHOSEN, INTERRUPTED, NONE_CHOSEN], 2),
        ("test", [NONE_CHOSEN, NONE_CHOSEN, NONE_CHOSEN], 2),
        ("campaign", [NONE_CHOSEN, PASSED, NONE_CHOSEN, NONE_CHOSEN], 0),
        ("campaign", [PASSED, PASSED, PASSED, FAILED], 2),
    ],
)
def test_parts_without_a_chosen_test_have_not_failed(tmp_path, target, statuses, status):
    """`make test PYTEST_ARGS="-k NAME"` ended in Error 1 when the test passed."""
    python = tmp_path / "python"
    python.write_text(
        '#!/bin/sh\ncd "$(dirname "$0")"; echo "$@" >> asked; read status < left; '
        "sed -i 1d left; exit $status\n"
    )
    python.chmod(0o755)
    (tmp_path / "left").write_text("".join(f"{code}\n" for code in statuses))
    done = subprocess.run(
        ["make", "-o", ".venv/.ready", target, f"PYTHON={python}", "PYTEST_ARGS=-k 'this one'"],
        cwd=ROOT, capture_output=True, text=True, timeout=60, check=False,
        env={name: value for name, value in os.environ.items() if not name.startswith("MAKE")},
    )  # fmt: skip
    assert done.returncode == status, done.stdout + done.stderr
    asked = (tmp_path / "asked").read_text().splitlines()
    assert len(asked) == len(statuses) and all("-k this one" in line for line in asked)
    assert ("no test was chosen" in done.stdout) == (set(statuses) == {NONE_CHOSEN})
