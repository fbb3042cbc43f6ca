# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The dashboard as its users have it: in a browser, beside real nodes."""

import itertools
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from bench import call, get_double, set_parameters, spin_until
from browser import PHONE, get, needs_browser, until, window
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from test_commission import BEFORE, PATIENT, QUICK, TRAVEL, VALVE, VOLTAGE

from valve_control.control.parameters.table import CONTROLLER
from valve_control.nodes.adapter import SAMPLES
from valve_control.nodes.harness.processes import process

pytestmark = [pytest.mark.browser, needs_browser]

CONFIG = Path(__file__).resolve().parents[2] / "config"
PICTURES = Path(os.environ.get("DASHBOARD_PICTURES", "out/dashboard_pictures"))
TOKEN = "secret"
NUMBERS = itertools.count(1)
# 200 samples a second, and a loop that bears the pauses of a busy machine: the page is tested here.
CALM = {
    "controller": [
        "sample_period:=0.005", "lvdt.hold_samples:=2000", "lvdt.period_limit:=1000.0",
        "lvdt.frozen_samples:=0", "lvdt.disturbance:=0.0", "command_timeout:=0.0", "state_decimation:=2",
        "lvdt.max_rate:=1e7", "pid.kp:=1.0", "pid.ki:=20.0", "pid.kd:=0.0",
    ],
    "valve_simulator": [
        "sample_period:=0.005", "voltage_timeout:=0.0", "patience:=0.2", "friction.coulomb:=0.2",
    ],
    "command_source": [
        "sample_period:=0.005", "scenario:=sine", "frequency:=0.5", "amplitude:=1.0", "duration:=36000.0",
    ],
}  # fmt: skip


@contextmanager
def node(name, folder, *more, namespace=""):
    config = {"controller": "pid_plain.yaml", "valve_simulator": "d3fxe.yaml"}.get(name)
    arguments = ["--params-file", str(CONFIG / config)] if config else []
    for setting in (*CALM.get(name, ()), *more):
        arguments += ["-p", setting]
    if namespace:
        arguments += ["-r", f"__ns:={namespace}"]
    with process(name, arguments, folder / f"{name}{namespace.replace('/', '_')}.log") as child:
        yield child


def address(folder):
    """Address of the page, from what the dashboard says."""
    log = folder / "dashboard.log"
    until(lambda: "open http" in log.read_text(), "the dashboard's address")
    return log.read_text().split("open ")[1].split()[0]


@contextmanager
def dashboard(folder, *more):
    arguments = ["port:=0", f"token:={TOKEN}", f"folder:={folder}/made", *more]
    with process("dashboard", [w for s in arguments for w in ("-p", s)], folder / "dashboard.log"):
        yield address(folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("dashboard")


@pytest.fixture(scope="module")
def page_address(folder):
    with (
        node("valve_simulator", folder),
        node("controller", folder),
        node("command_source", folder),
        dashboard(folder) as found,
    ):
        yield found


@pytest.fixture(scope="module")
def browser():
    with window() as made:
        yield made


@pytest.fixture
def page(browser, page_address, ros):
    """The page, with the token, when it shows data and its form with the values of the start."""
    start = {
        "controller": "pid",
        "pid__kp": 1.0,
        "pid__ki": 20.0,
        "pid__kd": 0.0,
        "pid__static_feedforward": 1.18,
    }
    assert set_parameters(ros, **start).successful
    browser.open(page_address)
    browser.wait_for("#standing", "This window writes")
    until(lambda: browser.plots().get("live") == "true", "live data")
    browser.find("[data-name='pid.kp'] input")
    if browser.enabled("#discard"):
        browser.press("#discard")
    until(lambda: browser.shown("pid.kp") == "1.0", "the value of the start")
    return browser


def picture(page, name):
    """Keep a picture of what the window shows."""
    moving = "return document.getAnimations().filter((a) => a.playState === 'running').length"
    until(lambda: page.js(moving) == 0, "the end of all transitions")
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.driver.save_screenshot(str(PICTURES / f"dashboard_{name}.png"))


def settled(read):
    """What ``read`` gives once it has given it twice."""
    values = [None]

    def twice():
        values.append(read())
        time.sleep(0.3)
        return values[-1] == values[-2]

    until(twice, "a value that stays")
    return values[-1]


def kp(ros):
    return get_double(ros, "pid.kp")


def usual_error(page):
    """Highest rms of the error that the page tells over three periods of the sine, once the loop is calm."""
    until(lambda: page.figure("e_M") < 0.5, f"errors of 0.2 to 0.3 V: {page.text('#indices')}")
    begin, highest = time.monotonic(), 0.0
    while time.monotonic() < begin + 6.0:
        highest = max(highest, page.figure("e_rms"))
    return highest


def test_a_gain_moved_by_its_slider_changes_the_loop_and_the_plot(page, ros):
    from selenium.webdriver import Keys

    before, error = kp(ros), usual_error(page)
    slider = page.find("[data-name='pid.kp'] .q-slider")
    page.drag(slider, page.js("return arguments[0].querySelector('.q-slider__thumb')", slider), 0.6)
    spin_until(ros, lambda: kp(ros) > 2.0 * before, "a larger gain")
    focus = page.find(
        "[data-name='pid.kp'] .q-slider [tabindex='0'], [data-name='pid.kp'] .q-slider[tabindex='0']"
    )
    moved = settled(lambda: kp(ros))
    page.js("arguments[0].focus()", focus)
    page.keys(Keys.ARROW_LEFT)
    spin_until(ros, lambda: 0.9 * moved < kp(ros) < moved, "one step of the keyboard")
    # All moves of one slider in quick succession are one change.
    until(lambda: settled(lambda: kp(ros)) == before or page.press("#undo"), "the gain as before")
    slider = page.find("[data-name='pid.ki'] .q-slider")
    page.drag(slider, page.js("return arguments[0].querySelector('.q-slider__thumb')", slider), -0.1)
    spin_until(ros, lambda: get_double(ros, "pid.ki") == 0.0, "the integral gain at the left end")
    until(lambda: page.shown("pid.ki") == "0.0", "the value beside the slider")
    page.type("pid.static_feedforward", "0,05")  # with a decimal comma
    spin_until(ros, lambda: get_double(ros, "pid.static_feedforward") == 0.05, "the feedforward")
    # Without integral and almost no feedforward the error is larger, and so it is drawn.
    until(
        lambda: page.figure("e_rms") > 1.5 * error, f"a larger error than {error} V: {page.text('#indices')}"
    )
    page.click("#tab-log")
    page.wait_for("#log", "pid.static_feedforward 1.18 → 0.05")
    page.click("#tab-tune")
    until(lambda: page.js("return !!document.querySelector('#undo')?.offsetParent"), "the form")
    until(lambda: page.figure("e_M") < 2.0, "the end of what the large gain did")
    picture(page, "tune")
    page.press("#undo")
    spin_until(ros, lambda: get_double(ros, "pid.static_feedforward") == 1.18, "the feedforward as before")
    page.press("#undo")
    spin_until(ros, lambda: get_double(ros, "pid.ki") == 20.0, "the integral gain as before")
    until(lambda: page.figure("e_rms") < 1.2 * error, "the error as before")
    page.keys("y")
    spin_until(ros, lambda: get_double(ros, "pid.ki") == 0.0, "the change made again with Y")
    page.keys("u")
    spin_until(ros, lambda: get_double(ros, "pid.ki") == 20.0, "taken back again with U")


def test_a_refused_value_shows_its_reason_and_changes_nothing(page, ros):
    before = kp(ros)
    page.type("pid.kp", "-3,5")
    until(lambda: "-3.5 is out of range: 0 to 1e+06" in page.refusal("pid.kp"), "the reason")
    page.type("pid.kp", "1,234.5")
    until(lambda: "without separators of thousands" in page.refusal("pid.kp"), "the reason")
    # What only the node knows: it refuses poles slower than the valve.
    page.type("pid.break_frequency", "0.1")
    until(lambda: "slower than the valve itself" in page.refusal("pid.break_frequency"), "the node's reason")
    assert "nothing was changed" in page.refusal("pid.break_frequency")
    assert kp(ros) == before and get_double(ros, "pid.break_frequency") == 0.0
    picture(page, "refused")
    page.press("#discard")
    until(lambda: page.shown("pid.kp") == str(before) and not page.refusal("pid.kp"), "the value in force")


def test_several_changes_are_applied_together_or_not_at_all(page, ros):
    page.press("#at-once .q-toggle__inner, #at-once")
    page.type("pid.kp", "1.2")
    page.type("pid.break_frequency", "0.1")
    page.wait_for("#apply", "Apply 2 together")
    assert kp(ros) == 1.0
    page.press("#apply")
    page.wait_for("#refusal", "none of the 2 was changed")
    assert kp(ros) == 1.0
    chosen = "[data-name='controller'] .q-select"
    page.choose(chosen, "arc")  # a choice waits in its field too
    page.wait_for("#apply", "Apply 3 together")
    assert "arc" in page.text(chosen)
    page.choose(chosen, "pid")
    page.wait_for("#apply", "Apply 2 together")
    # A reload loses nothing: what was typed is there, and not applied.
    page.open(page.driver.current_url)
    page.wait_for("#standing", "This window writes")
    until(lambda: page.shown("pid.kp") == "1.2" and page.shown("pid.break_frequency") == "0.1", "the drafts")
    page.press("#discard")
    until(lambda: page.shown("pid.kp") == "1.0", "the values in force")


def test_two_sets_are_compared_with_a_key(page, ros):
    page.press("#keep-a")
    page.wait_for("#sets", "set A is kept")
    page.type("pid.kp", "1.4")
    page.type("pid.kd", "0,01")
    spin_until(ros, lambda: get_double(ros, "pid.kd") == 0.01, "the second set")
    until(lambda: page.shown("pid.kd") == "0.01", "the second set on the page")
    page.press("#keep-b")
    page.wait_for("#sets", "A / B differ in 2")
    page.blur()
    for expected in ((1.0, 0.0), (1.4, 0.01), (1.0, 0.0)):
        page.keys("x")
        spin_until(ros, lambda e=expected: (kp(ros), get_double(ros, "pid.kd")) == e, f"{expected}")
    # A key pressed in a field is a letter, not a command.
    page.click("[data-name='pid.kp'] input")
    page.keys("x", " ")
    page.blur()
    until(lambda: "is no number" in page.refusal("pid.kp"), "the letter in the field")
    assert kp(ros) == 1.0
    page.press("#discard")


def test_what_others_change_is_shown_and_can_be_undone(page, ros):
    assert set_parameters(ros, pid__kp=1.3).successful
    until(lambda: page.shown("pid.kp") == "1.3", "the value that somebody else has set")
    page.click("#tab-log")
    page.wait_for("#log", "pid.kp 1.0 → 1.3 (from elsewhere)")
    page.click("#tab-tune")
    page.press("#undo")
    spin_until(ros, lambda: kp(ros) == 1.0, "undone")


def test_the_law_is_switched_and_back(page, ros):
    page.click("[data-name='controller'] .q-select")
    until(lambda: page.driver.find_elements("css selector", ".q-menu .q-item"), "the laws")
    for item in page.driver.find_elements("css selector", ".q-menu .q-item"):
        if item.text == "arc":
            item.click()
            break
    page.find("[data-name='arc.k1'] input")
    page.press("#undo")
    until(
        lambda: page.driver.find_elements("css selector", "[data-name='pid.kp'] input"), "the form of the PID"
    )


def test_parameters_are_saved_and_loaded(page, ros, folder):
    page.fill("file", f"{folder}/saved.yaml")
    page.press("#save")
    page.wait_for("#file-answer", f"wrote {folder}/saved.yaml")
    saved = yaml.safe_load((folder / "saved.yaml").read_text())["/controller"]["ros__parameters"]
    assert saved["pid"]["kp"] == 1.0
    page.type("pid.kp", "1.1")
    spin_until(ros, lambda: kp(ros) == 1.1, "a change")
    page.press("#load")
    page.wait_for("#file-answer", "of which")
    spin_until(ros, lambda: kp(ros) == 1.0, "the saved value")
    until(lambda: page.shown("pid.kp") == "1.0", "the saved value on the page")


def test_space_stops_the_valve_and_it_is_activated_again(page):
    from selenium.webdriver import Keys

    page.blur()
    page.keys(Keys.SPACE)
    page.wait_for("#mode", "inactive")
    page.press("#activate")
    until(lambda: "inactive" not in page.text("#mode"), f"active: {page.text('#mode')}")
    # Also while a button has the focus, which space would press otherwise.
    page.js("document.querySelector('#keep-a').focus()")
    page.keys(Keys.SPACE)
    page.wait_for("#mode", "inactive")
    page.press("#activate")
    until(lambda: "inactive" not in page.text("#mode"), "active again")
    page.press("#stop")
    page.wait_for("#mode", "inactive")
    page.press("#activate")
    until(lambda: "inactive" not in page.text("#mode"), "active again")


def test_pause_zoom_terms_and_view_outlive_a_reload(page):
    page.js("document.querySelector('.vc-plots').focus()")
    page.keys("p")
    until(lambda: page.text(".vc-live") == "paused", "paused")
    end = settled(lambda: page.plots()["end"])
    frames = int(page.plots()["frames"])
    until(lambda: int(page.plots()["frames"]) > frames + 5, "more frames")
    assert page.plots()["end"] == end
    page.keys("+")
    until(lambda: float(page.plots()["end"]) - float(page.plots()["start"]) == pytest.approx(2.5), "zoomed")
    page.click(".vc-terms summary")
    page.click(".vc-list input[value='unsaturated_voltage']")
    until(lambda: "unsaturated_voltage" in page.text("[data-panel=terms] .vc-legend"), "the term's legend")
    page.click(".vc-terms summary")
    picture(page, "terms")
    page.open(page.driver.current_url)
    until(lambda: page.text(".vc-live") == "paused", "still paused")
    assert page.plots()["end"] == end
    until(lambda: "unsaturated_voltage" in page.text("[data-panel=terms] .vc-legend"), "still the term")
    page.keys("l")
    until(lambda: page.text(".vc-live") == "live", "live")
    until(lambda: float(page.plots()["end"]) > float(end) + 0.5, "moving on")


def test_no_request_leaves_the_host(page, page_address):
    """The browser can resolve no name; all that the page asked for is of its own address."""
    page.requests()
    page.open(page_address)
    page.click("#tab-do")
    page.click("#tab-latency")
    page.find("#latency svg")
    page.click("#tab-tune")
    own = page_address.split("?")[0]
    foreign = [
        url for url in page.requests()
        if not url.startswith((own, own.replace("http", "ws"), "data:", "blob:"))
    ]  # fmt: skip
    assert foreign == []
    errors = [e for e in page.driver.get_log("browser") if e["level"] == "SEVERE"]
    assert errors == []


def test_one_window_writes_and_those_without_token_look(page, page_address, ros):
    own = page_address.split("?")[0]
    with window() as other:
        other.open(own)
        other.wait_for("#standing", "its address has no token")
        assert not other.enabled("#undo") and not other.enabled("#stop")
        other.open(f"{own}?token=wrong")
        other.wait_for("#standing", "the token in its address is wrong")
        # Also who gets around what the page shows: the server asks again.
        other.js("document.querySelectorAll('[inert]').forEach((e) => e.removeAttribute('inert'))")
        other.find("[data-name='pid.kp'] input")
        other.type("pid.kp", "3")
        other.wait_for(".q-notification", "may only look")
        other.keys("u", " ")
        assert kp(ros) == 1.0
        other.open(page_address)
        other.wait_for("#standing", "Another window writes")
        assert not other.enabled("#undo")
        other.click("#claim")
        other.wait_for("#standing", "This window writes")
        page.wait_for("#standing", "Another window writes")
        page.click("#claim")
        page.wait_for("#standing", "This window writes")
    assert "inactive" not in page.text("#mode")


def choose(page, name):
    """Choose a valve."""
    until(lambda: page.js("return !!document.querySelector('.vc-choice')?.offsetParent"), "several valves")
    page.click(".vc-choice")

    def item():
        items = page.driver.find_elements("css selector", ".q-menu .q-item")
        return next((i for i in items if i.text == name), None)

    until(item, f"{name} among the valves").click()
    until(lambda: name in page.text(".vc-choice"), f"{name} chosen")


def test_a_killed_controller_is_seen_and_its_successor_too(page, tmp_path, ros):
    valve = f"boom{next(NUMBERS)}"  # a valve that the page has not seen, also when the test is repeated
    name, namespace = f"{valve}/controller", f"/{valve}"
    with node("valve_simulator", tmp_path, namespace=namespace):
        with node("controller", tmp_path, namespace=namespace) as child:
            choose(page, valve)
            page.wait_for("#tune-hint", f"/{name}: ")
            page.find("[data-name='pid.kp'] input")
            page.type("pid.kp", "0.9")
            spin_until(ros, lambda: get_double(ros, "pid.kp", name) == 0.9, "a change")
            child.send_signal(signal.SIGKILL)
            page.wait_for("#mode", "silent")
        with node("controller", tmp_path, namespace=namespace):
            log = tmp_path / f"controller_{valve}.log"
            until(lambda: "waiting for spool_position" in log.read_text(), "the successor")
            page.click("#tab-log")
            page.wait_for("#log", f"/{name} was started anew")
            page.wait_for("#log", "came back with other values of pid.kp")
            page.click("#tab-tune")
            page.press("#restore")
            spin_until(ros, lambda: get_double(ros, "pid.kp", name) == 0.9, "the lost value")
    choose(page, "valve")


def test_commands_recordings_and_faults(page, tmp_path, folder):
    page.click("#tab-do")
    page.wait_for("#command-state", "/command_source")
    page.press("#start")
    page.wait_for("#command-refusal", "/command_source commands this valve already")
    with node("valve_simulator", tmp_path, namespace="/arm"), node("controller", tmp_path, namespace="/arm"):
        choose(page, "arm")
        page.find("#fault-lvdt")
        until(lambda: page.text("#command-state") == "nobody commands this valve", "no command")
        page.wait_for("#mode", "no command yet")
        page.fill("command-amplitude", "5")
        page.press("#start")
        page.wait_for("#command-refusal", "this sine reaches 5 V; the limit is 3 V; nothing was sent")
        page.fill("command-amplitude", "x")
        page.press("#start")
        page.wait_for("#command-refusal", "amplitude: 'x' is no number; nothing was sent")
        page.fill("command-amplitude", "0,8")
        page.press("#record")
        page.wait_for("#record-state", "messages")
        page.press("#start")
        page.wait_for("#command-state", "/arm/page_command")
        until(lambda: page.figure("e_rms") > 0.0, "an error")
        until(lambda: "no command yet" not in page.text("#mode"), "the command in force")
        settled(lambda: round(page.figure("e_rms"), 2))
        if "DASHBOARD_PICTURES" in os.environ:  # for the docs: without the start of the command
            until(lambda: page.figure("e_M") < 0.4, "five seconds of steady motion", 60.0)
        picture(page, "do")
        page.press("#end")
        until(lambda: page.text("#command-state").endswith("nobody commands this valve"), "the command's end")
        page.press("#inject")  # nothing chosen yet: no fault
        assert page.text("#fault-answer") == ""
        page.choose("#fault-valve", "stuck")
        page.press("#inject")
        page.click("#tab-log")
        page.wait_for("#log", "fault.valve none → stuck")
        page.click("#tab-do")
        page.press("#no-faults")
        page.press("#end-record")
        page.wait_for("#report", "report of recording")
        link = page.js("return document.querySelector('#report').href")
        status, text = get(link)
        assert status == 200 and "<html" in text[:500].lower() and "plotly" in text
        assert (folder / "made" / link.rsplit("/", 1)[1]).exists()
    choose(page, "valve")


def start_run(page, name, arguments):
    """Choose a run, fill in its arguments, start it."""
    page.click("#tab-do")
    page.choose("#run", name)
    page.fill("arguments", arguments)
    page.press("#start-run")
    page.wait_for("#run-state", f"{name}: running")


def progress(page):
    """The share of the run that is done, as its bar shows it; None while there is no bar."""
    return page.js(
        "const e = document.querySelector('#run-share');"
        "return e && e.offsetParent ? +e.getAttribute('aria-valuenow') : null"
    )


def links(page):
    """Addresses of what the run has written, by their text, in the order of the page."""
    found = page.js("return [...document.querySelectorAll('#made a')].map((a) => [a.innerText, a.href])")
    return dict(found)


def test_a_run_shows_its_progress_and_what_it_wrote(page):
    page.click("#tab-do")
    typed = "--set steps=3 cycles=3 --set step_time=0.1 --output valve.yaml"
    page.fill("arguments", typed)
    page.choose("#run", "tune")
    page.choose("#run", "identify")  # what was typed is there again
    until(
        lambda: page.js("return document.querySelector('#arguments input').value") == typed, "the arguments"
    )
    page.press("#start-run")
    page.wait_for("#run-state", "ended with status 2")
    assert "unrecognized" in page.text("#output") or "valve-control" in page.text("#output")
    start_run(
        page, "identify", "--valve second_order --set lvdt.noise=0.002 --output valve.yaml --figure b.png"
    )
    page.wait_for("#run-state", "done", 120.0)
    page.wait_for("#made", "b.png")
    assert list(links(page)) == ["valve.yaml", "b.png"]
    assert all(get(link)[0] == 200 for link in links(page).values())


def test_gains_that_tune_has_found_are_loaded_and_taken_back(page, ros):
    start_run(
        page,
        "tune",
        "--controller pid --budget 400 --valves 2 --unseen 4 --duration 2 --sample-period 0.005 "
        "--gain-margin 1 --phase-margin 5 --peak 30 --saturation 1 --output tuned.yaml",
    )
    page.wait_for("#run-explained", "Nothing on the graph is touched")
    until(lambda: (progress(page) or 0.0) > 0.0, "the progress", 120.0)
    page.wait_for("#run-state", "done", 240.0)
    page.wait_for("#made", "tuned.yaml")
    assert list(links(page)) == ["tuned.yaml"]
    page.press("#load-made")
    page.wait_for("#run-refusal", "of which")
    spin_until(ros, lambda: kp(ros) != 1.0, "the tuned gain")
    page.click("#tab-tune")
    until(lambda: page.shown("pid.kp") == str(kp(ros)), "the tuned gain on the page")
    page.press("#undo")
    spin_until(ros, lambda: kp(ros) == 1.0, "the gain as before")


def test_a_run_is_cancelled(page):
    start_run(page, "tune", "--controller pid --budget 4000 --output never.yaml")
    page.press("#start-run")
    page.wait_for("#run-refusal", "tune is still running; end it first")
    until(lambda: progress(page) is not None, "the progress", 120.0)
    page.press("#cancel-run")
    page.wait_for("#run-state", "tune: cancelled")
    assert "Traceback" not in page.text("#output") and not links(page)


@contextmanager
def to_commission(page, folder):
    """A controller with parameters of its own and its valve, chosen on the page; its full name."""
    valve = f"press{next(NUMBERS)}"
    space = ["-r", f"__ns:=/{valve}"]
    with (
        process("valve_simulator", [*VALVE, *space], folder / "sim.log"),
        process("controller", [*BEFORE, *PATIENT, *space], folder / "c.log"),
    ):
        choose(page, valve)
        page.wait_for("#mode", "no command yet")
        page.click("#tab-do")
        page.choose("#run", "commission")
        until(lambda: f"--node /{valve}/controller" in offered(page), "the name of the controller")
        page.wait_for("#run-explained", "Moves the spool")
        limits = f" --max-voltage {VOLTAGE} --travel {TRAVEL} --controller dcarc --alone "
        page.fill("arguments", offered(page) + limits + " ".join(QUICK))
        yield f"{valve}/controller"
    choose(page, "valve")


def offered(page):
    """The arguments that stand in the field."""
    return page.js("return document.querySelector('#arguments input')?.value ?? ''")


def all_parameters(ros, name):
    names = [p.name for p in CONTROLLER]
    got = call(ros, GetParameters, f"/{name}/get_parameters", GetParameters.Request(names=names)).values
    return {name: parameter_value_to_python(value) for name, value in zip(names, got, strict=True)}


def test_a_valve_is_commissioned_from_the_page(page, tmp_path, ros):
    with to_commission(page, tmp_path) as name:
        assert all_parameters(ros, name)["controller"] == "arc"
        page.press("#start-run")
        page.wait_for("#run-state", "commission: running")
        until(lambda: 0.0 < (progress(page) or 0.0) < 1.0, "the progress", 60.0)
        page.press("#start")  # two commands would fight
        page.wait_for("#command-refusal", "commissioner commands this valve already")
        page.wait_for("#run-state", "commission: done", 300.0)
        folder = f"commission_{name.split('/')[0]}"
        page.wait_for("#made", f"report {folder}/report.html")
        status, text = get(links(page)[f"report {folder}/report.html"])
        assert status == 200 and "The gains of dcarc are accepted" in text
        assert f"{folder}/before.yaml" in links(page)
        assert all_parameters(ros, name)["controller"] == "dcarc"
        page.click("#tab-tune")
        page.find("[data-name='dcarc.model']")  # the form is that of the law in force
        assert "inactive" not in page.text("#mode")


@pytest.mark.parametrize("button", ["#cancel-run", "#stop"])
def test_a_commissioning_that_is_ended_leaves_0_v_and_the_parameters_from_before(page, tmp_path, ros, button):
    with to_commission(page, tmp_path) as name:
        before = all_parameters(ros, name)
        page.press("#start-run")
        until(lambda: 0.0 < (progress(page) or 0.0) < 1.0, "the progress", 60.0)
        assert all_parameters(ros, name) != before
        page.press(button)
        until(lambda: page.text("#run-state") in ("commission: cancelled", "commission: ended with status 1"),
              "the end of the run")  # fmt: skip
        page.wait_for("#output", "all its parameters are as before")
        assert "Traceback" not in page.text("#output")
        assert all_parameters(ros, name) == before
        page.wait_for("#mode", "inactive")
        page.click("#tab-tune")
        until(lambda: page.shown("arc.k1") == "77.0", "the form with the values from before")
        page.press("#activate")
        until(lambda: "inactive" not in page.text("#mode"), "active again")


def shown_number(page, panel, name):
    """Newest number of a signal in the legend of a panel, NaN if there is none."""
    found = re.search(rf"{name} (-?[\d.]+)", page.text(f"[data-panel={panel}] .vc-legend"))
    return float(found[1]) if found else float("nan")


def test_the_signals_of_an_axis_are_drawn_and_its_stop_is_said_and_ended(page, tmp_path, ros):
    lockstep = {
        "axis_simulator": ["clock:=lockstep"],
        "controller": ["lockstep:=true", "lvdt.frozen_samples:=0"],
        "axis_controller": ["lockstep:=true"],
    }
    assert not page.js("return !!document.querySelector('[data-panel=axis]').offsetParent")
    axis = f"/crane{next(NUMBERS)}"
    goal = ros.create_publisher(Float64, f"{axis}/goal_position", SAMPLES)
    words = ["-r", f"__ns:={axis}", "--params-file", str(CONFIG / "axis" / "bench.yaml")]
    simulated, controller, upper = (
        process(name, words + [w for s in own for w in ("-p", s)], tmp_path / f"{name}.log")
        for name, own in lockstep.items()
    )
    with simulated, controller, upper:
        choose(page, axis[1:])
        until(lambda: shown_number(page, "axis", "position") > 0.1, "the position of the piston", 120.0)
        assert 1.0 < shown_number(page, "pressures", "pressure_a") < 200.0  # bar
        assert 1.0 < shown_number(page, "pressures", "pressure_b") < 200.0
        begun = shown_number(page, "axis", "position")
        spin_until(ros, lambda: goal.get_subscription_count() == 1, "axis_controller")
        aim = Float64(data=begun + 0.03)
        # A reader may know of its writer later than the writer of it: what is sent before is lost.
        until(lambda: goal.publish(aim) or shown_number(page, "axis", "goal") > begun + 1e-3, "a moving goal")
        until(lambda: abs(shown_number(page, "axis", "goal") - aim.data) < 1e-3, "the goal")
        until(lambda: abs(shown_number(page, "axis", "position") - begun - 0.03) < 2e-3, "the piston")
        picture(page, "axis")
        assert call(ros, Trigger, f"{axis}/axis_controller/stop", Trigger.Request()).success
        page.wait_for("#notice", f"{axis}/axis_controller: stopped")
        page.wait_for("#mode", "inactive")
        page.press("#reset")
        until(lambda: page.text("#notice") == "", "the end of the stop")
        until(lambda: "inactive" not in page.text("#mode"), "active again")
    choose(page, "valve")


@contextmanager
def stranger(page, which, folder):
    """A node that is no controller of this version, as it is shown; afterwards the valve is shown again."""
    with (folder / f"{which}.log").open("wb") as log:
        child = subprocess.Popen(
            [sys.executable, Path(__file__).with_name("strangers.py"), which], stdout=log, stderr=log
        )
        try:
            choose(page, which)
            yield
        finally:
            child.terminate()
            child.wait(10.0)
    choose(page, "valve")


def test_an_older_controller_is_named_and_what_it_has_can_be_used(page, tmp_path, ros):
    with stranger(page, "older", tmp_path):
        page.wait_for("#notice", "/older/older is an older or another controller: it has no parameter")
        page.wait_for("#notice", "no change_state (it cannot be stopped or activated from here)")
        page.wait_for("#notice", "/older/older/state does not name its numbers")
        until(lambda: page.plots().get("live") == "true", "its signals")
        page.type("kp", "2,5")
        spin_until(ros, lambda: get_double(ros, "kp", "older/older") == 2.5, "its gain")
        page.press("#save")
        page.wait_for("#file-answer", "it has no save_parameters")
        page.press("#stop")
        page.click("#tab-log")
        page.wait_for("#log", "NOT stopped: /older/older has no service change_state")
        page.click("#tab-tune")
    until(lambda: "inactive" in page.text("#mode"), "the other valve is stopped")
    page.press("#activate")


def test_a_node_without_parameters_is_watched_and_said_to_be_unknown(page, tmp_path):
    with stranger(page, "unknown", tmp_path):
        page.wait_for("#mode", "no controller")
        page.wait_for("#notice", "valve_voltage comes from /unknown/unknown, which offers no parameters")
        page.wait_for("#tune-hint", "no controller")
        until(lambda: page.plots().get("live") == "true", "its signals")


def test_the_keyboard_alone_suffices(page, ros):
    from selenium.webdriver import Keys

    def go(selector):
        """Press Tab until what has the focus is inside ``selector``."""
        for _ in range(80):
            page.keys(Keys.TAB)
            if page.js("return !!document.activeElement.closest(arguments[0])", selector):
                return
        raise AssertionError(f"Tab does not come to {selector}")

    page.blur()
    go("[data-name='pid.kp'] input")
    page.select_all()
    page.keys("1,25", Keys.ENTER)
    spin_until(ros, lambda: kp(ros) == 1.25, "the gain that was typed")
    go("[data-name='pid.kp'] .q-slider")
    page.keys("u")
    spin_until(ros, lambda: kp(ros) == 1.0, "undone")
    page.blur()
    go(".vc-terms summary")
    page.keys(Keys.ENTER)
    go(".vc-list")
    assert page.js("return document.activeElement.type") == "checkbox"
    page.js("document.querySelector('.vc-terms').open = false")
    go("#tab-tune")
    page.keys(Keys.ARROW_RIGHT, Keys.ENTER)
    go("#scenario")
    page.click("#tab-tune")


def test_a_phone_shows_all_of_it(page_address):
    with window(screen=PHONE) as phone:
        phone.open(page_address)
        phone.find("[data-name='pid.kp'] input")
        width, inner = phone.js("return [document.documentElement.scrollWidth, window.innerWidth]")
        assert width <= inner == PHONE["width"]
        box = phone.js("return document.querySelector('#stop').getBoundingClientRect().toJSON()")
        assert box["right"] <= inner and box["height"] >= 40
        picture(phone, "phone")
        for tab in ("do", "log", "latency"):
            phone.click(f"#tab-{tab}")
            until(lambda: phone.js("return document.documentElement.scrollWidth") <= inner, f"{tab} in width")


def test_without_a_valve_the_page_says_what_is_missing(browser, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "102")
    with dashboard(tmp_path) as found:
        browser.driver.get(found)
        browser.wait_for("#notice", "No valve on the graph yet")
        picture(browser, "none")
    browser.wait_for(".vc-live", "no connection to the dashboard; trying again")
