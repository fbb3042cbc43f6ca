# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Services beside a running loop: many calls, clients that leave, requests that make no sense."""

import os
import subprocess
import sys
import time
from contextlib import suppress

import pytest
from bench import Bench, call, controller, get_double, spin_until
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameters
from std_srvs.srv import SetBool, Trigger

from research.campaigns.processes import wait_until
from valve_control.nodes.services import MOST_ENTRIES, Reception, Unwatched

# For each name that it reads: asks that service, leaves it, and says so when the server has seen it leave.
LEAVER = """
import sys, rclpy
from bench import introduce
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("leaver")
for name in map(str.strip, sys.stdin):
    client = node.create_client(Trigger, name)
    assert client.wait_for_service(20.0)
    introduce(node, "/test")
    client.call_async(Trigger.Request())
    node.destroy_client(client)
    introduce(node, "/test")
    print("left", flush=True)
"""


class One:
    """A node with one service, that logs like ``ros``."""

    def __init__(self, ros, service):
        self.services = [service]
        self.get_logger = ros.get_logger


def patient_client(ros):
    """Whose queues hold all calls; the usual ones hold ten."""
    name = "/controller/set_parameters"
    client = ros.create_client(SetParameters, name, qos_profile=qos_profile_parameters)
    spin_until(ros, client.service_is_ready, name)
    assert get_double(ros, "arc.k1") == 120.0  # from here on both see each other
    return client


def ask(client, name, value):
    parameter = Parameter(name, value=value).to_parameter_msg()
    return client.call_async(SetParameters.Request(parameters=[parameter]))


def answer_of(ros, reception, client, request):
    future = client.call_async(request)
    spin_until(ros, lambda: reception.waiting, "the request")
    while reception.waiting:
        reception.serve()
    spin_until(ros, future.done, "the answer")
    return future.result()


@pytest.mark.campaign
def test_an_answer_to_a_client_that_has_left_does_not_hold_up_the_loop(ros, tmp_path):
    """The least of several times, beside what the same answers cost rclpy's own way.

    A client that leaves at once may take its request with it; then it is asked to come again.
    """
    services = [ros.create_service(Trigger, name, lambda _, response: response) for name in ("ours", "plain")]
    services[1].callback_group = Unwatched()
    reception = Reception([One(ros, services[0])])
    took = {"ours": [], "plain": []}

    def served(name):
        began = time.monotonic()
        if name == "ours":
            if not reception.waiting:
                return False
            reception.serve()
        else:
            with services[1].handle:
                taken = services[1].handle.service_take_request(Trigger.Request)
            if taken == (None, None):
                return False
            began = time.monotonic()
            services[1].send_response(Trigger.Response(), taken[1])
        took[name].append(time.monotonic() - began)
        return True

    left = tmp_path / "left"
    with (
        left.open("wb") as output,
        subprocess.Popen(
            [sys.executable, "-c", LEAVER], stdin=subprocess.PIPE, stdout=output, text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        ) as leaver,
    ):  # fmt: skip
        for count, name in enumerate(("ours", "plain") * 8):
            if len(took[name]) < 4:
                print(name, file=leaver.stdin, flush=True)
                spin_until(ros, lambda n=count: left.read_text().count("left") > n, "the client's end")
                with suppress(RuntimeError):
                    wait_until(lambda name=name: served(name), "a request", [], limit=1.0)
        leaver.stdin.close()
    reception.close()
    assert all(len(times) == 4 for times in took.values()), took
    assert min(took["plain"]) > 0.05 and min(took["ours"]) < 0.1 * min(took["plain"]), took


def test_a_request_that_makes_no_sense_is_refused_and_the_node_goes_on(ros, tmp_path):
    with controller(tmp_path) as child:
        bench = Bench(ros)
        bench.connect()
        strange = ParameterMessage(name="arc.k1", value=ParameterValue(type=200))
        unknown = Parameter("arc.k7", value=1.0).to_parameter_msg()
        good = Parameter("arc.k1", value=77.0).to_parameter_msg()
        request = SetParameters.Request(parameters=[strange, unknown, good])
        results = call(ros, SetParameters, "/controller/set_parameters", request).results
        assert [result.successful for result in results] == [False, False, True]
        assert all(result.reason for result in results[:2]) and "arc.k7" in results[1].reason
        assert get_double(ros, "arc.k1") == 77.0
        bench.sample(0.1)
        assert child.poll() is None


@pytest.mark.parametrize("text", [None, "wrote /tmp/Pr\udcfcfstand/p.yaml"])
def test_a_service_that_fails_gives_an_empty_answer_and_the_loop_goes_on(ros, text):
    """It raises an error, or its answer has a name of the file system that is no UTF-8."""

    def answered(request, response):
        if request.data:
            response.success = True
            response.message = text  # None is refused by the message class
        return response

    reception = Reception([One(ros, ros.create_service(SetBool, "failing", answered))])
    client = ros.create_client(SetBool, "failing")
    spin_until(ros, client.service_is_ready, "failing")
    for data in (True, False):
        assert answer_of(ros, reception, client, SetBool.Request(data=data)) == SetBool.Response()
    reception.close()


def test_a_request_of_too_many_entries_is_refused_unread(ros, capfd):
    reception = Reception([One(ros, ros.create_service(SetParameters, "long", lambda *_: None))])
    client = ros.create_client(SetParameters, "long")
    spin_until(ros, client.service_is_ready, "long")
    request = SetParameters.Request(parameters=[ParameterMessage()] * (MOST_ENTRIES + 1))
    assert answer_of(ros, reception, client, request).results == []
    assert "/long: a request with 501 entries refused; 500 is the most" in capfd.readouterr().err
    reception.close()


def test_a_long_list_of_changes_leaves_the_samples_their_turn(ros, tmp_path):
    """Each takes about a period; all together they would be a standstill."""
    with controller(tmp_path):
        bench = Bench(ros)
        bench.connect()
        client = patient_client(ros)
        value = [ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=v) for v in (1.0, 2.0)]
        changes = [ParameterMessage(name="arc.k1", value=value[k % 2]) for k in range(400)]
        future = client.call_async(SetParameters.Request(parameters=changes))
        sampled = 0
        while not future.done():
            bench.sample(0.001 * (sampled % 2))
            sampled += 1
        assert sampled > 20
        assert all(result.successful for result in future.result().results)
