# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A path that begins with the home folder of a user who does not exist is refused in one sentence."""

import pytest

from valve_control.axis import axis_parameters
from valve_control.control.parameters import ros_file
from valve_control.control.parameters.table import RECORDER
from valve_control.nodes import recorder
from valve_control.parameter import ParameterError, defaults, updated

PATH = "~nobody_of_this_name/file"


@pytest.mark.parametrize(
    ("read", "what"),
    [
        (ros_file.sections, "parameter file"),
        (axis_parameters.known_machine, "machine"),
        (lambda path: recorder.settings(updated(RECORDER, defaults(RECORDER), {"bag": path})), "bag"),
    ],
)
def test_an_unknown_home_folder_is_no_traceback(read, what):
    with pytest.raises(ParameterError, match=f"^{what} {PATH}: there is no such user, or no home folder$"):
        read(PATH)
