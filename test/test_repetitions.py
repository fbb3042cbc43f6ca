# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A run that repeats more tests than its budget fails, although each passes in the end."""

import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
import pytest

tried = set()


@pytest.mark.parametrize("number", range({}))
def test_passes_when_repeated(number):
    again = number in tried
    tried.add(number)
    assert again
"""


@pytest.mark.parametrize(("repeated", "status"), [(5, 0), (6, 1)])
def test_repetitions_have_a_budget(tmp_path, repeated, status):
    (tmp_path / "test_those.py").write_text(TESTS.format(repeated), encoding="utf-8")
    (tmp_path / "conftest.py").write_text(
        Path(__file__).with_name("conftest.py").read_text(encoding="utf-8"), encoding="utf-8"
    )
    command = [sys.executable, "-m", "pytest", "-q", "--reruns", "1", "-p", "no:cacheprovider", tmp_path]
    environment_of_this = {"cwd": Path(__file__).parent, "capture_output": True, "text": True, "timeout": 60}
    done = subprocess.run(command, **environment_of_this)
    assert done.returncode == status, done.stdout + done.stderr
    assert f"{repeated} passed" in done.stdout
    assert f"{repeated} repetitions, at most 5 are allowed" in done.stdout
