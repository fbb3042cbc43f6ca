# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Samples at which nothing was read: time goes on, the filters see what was really applied."""

import changed
import pytest

from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.parameters import build


def begun(law):
    """Module, Params and State at rest of a law with its defaults."""
    module, p = LAWS[law].module, build.law_params(changed.controller(controller=law))
    return module, p, module.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("law", ["arc", "oarc", "dcarc", "pid"])
def test_reference_goes_on_as_if_nothing_were_lost(law):
    module, p, whole = begun(law)
    gapped = whole
    for k in range(40):
        _, whole, _ = module.step(p, whole, 1.0, 0.0, 0.0)
        if 10 <= k < 17:
            gapped = module.hold(p, gapped, 1.0, 0.0, 2.0)
        else:
            _, gapped, _ = module.step(p, gapped, 1.0, 0.0, 0.0)
    assert gapped.reference == whole.reference


@pytest.mark.parametrize("law", ["arc", "oarc", "dcarc"])
def test_estimates_rest_in_a_gap(law):
    module, p, s = begun(law)
    for _ in range(20):
        _, s, _ = module.step(p, s, 2.0, 0.0, 0.0)
    assert module.hold(p, s, 2.0, 1.0, 5.0).theta == s.theta
