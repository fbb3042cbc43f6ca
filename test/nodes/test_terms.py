# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Chosen terms of ~/state under names of their own."""

from bench import Motion, controller, set_parameters, spin_until
from std_msgs.msg import Float64


def listen(ros, names):
    """The numbers of each term, and whether all of them have a publisher."""
    got, heard = {name: [] for name in names}, []
    for name in names:
        topic = f"/controller/terms/{name}"
        heard.append(ros.create_subscription(Float64, topic, lambda m, n=name: got[n].append(m.data), 10))
    return got, lambda: all(subscription.get_publisher_count() == 1 for subscription in heard)


def test_terms_are_chosen_while_it_runs_and_wrong_names_refused(ros, tmp_path):
    motion, (got, matched) = Motion(ros), listen(ros, ("a1",))
    with controller(tmp_path):
        motion.bench.connect()
        result = set_parameters(ros, state_topics=["unsaturated_voltag"])
        assert not result.successful
        assert result.reason.startswith("state_topics has 'unsaturated_voltag', which is no term of any law")
        assert "did you mean 'unsaturated_voltage'" in result.reason
        assert set_parameters(ros, state_topics=["a1"]).successful
        spin_until(ros, matched, "publisher of the term")
        motion.move(20)
        spin_until(ros, lambda: got["a1"], "term")
        # The PID has no such estimate: silence, not a wrong number.
        assert set_parameters(ros, controller="pid").successful
        motion.bench.settle()
        before = len(got["a1"])
        motion.move(20)
        motion.bench.settle()
        assert len(got["a1"]) == before and matched()
        assert set_parameters(ros, state_topics=[""]).successful
        spin_until(ros, lambda: not matched(), "no publisher of the term")
