# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""One parameter: its type and range in words, and which values it takes."""

import math

import pytest

from valve_control.parameter import Parameter, ParameterError, defaults, missing, updated

GAIN = Parameter("gain", 120.0, "1/s", "a gain", 0.0, 500.0)
COUNT = Parameter("count", 3, "-", "a number", 1, 9)
ON = Parameter("on", True, "", "a switch")
LAW = Parameter("law", "arc", "", "a law", choices=("arc", "pid"), left_out=(("lqr", "it is not written"),))
NAME = Parameter("name", "x", "", "a name")
THETA = Parameter("theta", [1.0, 2.0], "", "estimates", -10.0, 10.0, length=2)
TOPICS = Parameter("topics", ["a"], "", "topics")
TABLE = (GAIN, COUNT, ON, LAW, NAME, THETA, TOPICS)


@pytest.mark.parametrize(
    ("parameter", "kind", "words"),
    [(GAIN, "double", "0 to 500"), (COUNT, "integer", "1 to 9"), (ON, "bool", ""),
     (LAW, "string", "arc, pid"),
     (NAME, "string", ""), (THETA, "list of doubles", "-10 to 10"), (TOPICS, "list of strings", "")],
)  # fmt: skip
def test_type_and_range_in_words(parameter, kind, words):
    assert (parameter.type_name, parameter.range_text) == (kind, words)


@pytest.mark.parametrize(
    ("parameter", "value", "said"),
    [(GAIN, 120, "gain is 120; it must be a double (write 120.0, not 120)"),
     (GAIN, "1,2", "gain is '1,2'; it must be a double (write 1.2, not 1,2)"),
     (GAIN, math.nan, "gain is nan; it must be finite"),
     (GAIN, 501.0, "gain is 501 1/s; it must lie between 0 and 500 1/s"),
     (COUNT, True, "count is True; it must be an integer"),
     (COUNT, 0, "count is 0; it must lie between 1 and 9"),
     (ON, 1, "on is 1; it must be a bool"),
     (NAME, 1, "name is 1; it must be a string (write it in quotes)"),
     (NAME, ["x"], "name is ['x']; it must be a string"),
     (LAW, "lqr", "law is 'lqr'; it is not written"),
     (LAW, "oarc", "law is 'oarc'; it must be 'arc' or 'pid'"),
     (THETA, 1.0, "theta is 1.0; it must be a list of doubles (write 120.0, not 120)"),
     (THETA, "12", "theta is '12'; it must be a list of doubles (write 120.0, not 120)"),
     (THETA, [1.0, 2], "theta is [1.0, 2]; it must be a list of doubles (write 120.0, not 120)"),
     (THETA, [1.0], "theta has 1 entries; it must have 2"),
     (THETA, [1.0, 11.0], "theta[1] is 11; it must lie between -10 and 10"),
     (TOPICS, [1.0], "topics is [1.0]; it must be a list of strings")],
)  # fmt: skip
def test_another_value_is_refused_in_one_sentence(parameter, value, said):
    with pytest.raises(ParameterError) as error:
        parameter.check(value)
    assert str(error.value) == said


def test_changes_are_taken_as_a_whole_and_names_are_known():
    values = defaults(TABLE)
    assert updated(TABLE, values, {"gain": 1.0, "topics": ("b", "c")}) == {
        **values, "gain": 1.0, "topics": ["b", "c"]
    }  # fmt: skip
    assert values == defaults(TABLE)
    with pytest.raises(ParameterError, match="^there is no parameter 'gian'; did you mean 'gain'\\?$"):
        updated(TABLE, values, {"gain": 1.0, "gian": 1.0})
    assert missing(TABLE, ["speed"]) == "there is no parameter 'speed'"
    said = missing(TABLE, ["gian", "speed"])
    assert said == "there are no parameters 'gian' (did you mean 'gain'?), 'speed'"
