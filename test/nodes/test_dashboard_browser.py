# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The dashboard as its users have it: in a browser, beside real nodes."""

import itertools
import re
import signal
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from bench import call, get_double, set_parameters, spin_until
from browser import needs_browser, until, window
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from research.campaigns.processes import process
from valve_control.nodes.adapter import SAMPLES

pytestmark = [pytest.mark.browser, needs_browser]

CONFIG = Path(__file__).resolve().parents[2] / "config"
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
    until(lambda: browser.shown("pid.kp") == "1.0", "the value of the start")
    return browser


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
    page.type("pid.static_feedforward", "0.05")
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
    page.type("pid.kp", "-3.5")
    until(lambda: "it must lie between 0 and 1e+06" in page.refusal("pid.kp"), "the reason")
    page.type("pid.kp", "x u ")  # keys pressed in a field are letters, not commands
    until(lambda: "pid.kp is 'x u'" in page.refusal("pid.kp"), "the reason")
    # What only the node knows: it refuses poles slower than the valve.
    page.type("pid.break_frequency", "0.1")
    until(lambda: "slower than the valve itself" in page.refusal("pid.break_frequency"), "the node's reason")
    assert "nothing was changed" in page.refusal("pid.break_frequency")
    assert kp(ros) == before and get_double(ros, "pid.break_frequency") == 0.0
    assert "inactive" not in page.text("#mode")


def test_space_stops_the_valve_and_it_is_activated_again(page):
    from selenium.webdriver import Keys

    page.blur()
    page.keys(Keys.SPACE)
    page.wait_for("#mode", "inactive")
    page.press("#activate")
    until(lambda: "inactive" not in page.text("#mode"), f"active: {page.text('#mode')}")
    # Also while a button has the focus, which space would press otherwise.
    page.js("document.querySelector('#save').focus()")
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
    page.click(".vc-list input[value='term.unsaturated_voltage']")
    until(lambda: "unsaturated_voltage" in page.text("[data-panel=terms] .vc-legend"), "the term's legend")
    page.click(".vc-terms summary")
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
    page.click("#tab-figures")
    page.wait_for("#figures", "latency_ms_p50")
    page.click("#tab-tune")
    own = page_address.split("?")[0]
    foreign = [
        url for url in page.requests()
        if not url.startswith((own, own.replace("http", "ws"), "data:", "blob:"))
    ]  # fmt: skip
    assert foreign == []
    errors = [e for e in page.driver.get_log("browser") if e["level"] == "SEVERE"]
    assert errors == []


def test_a_window_without_the_token_looks(page, page_address, ros):
    own = page_address.split("?")[0]
    with window() as other:
        for address in (own, f"{own}?token=wrong"):
            other.open(address)
            other.wait_for("#standing", "its address has no token, or a wrong one")
            assert not other.enabled("#undo") and not other.enabled("#stop")
        # Also who gets around what the page shows: the server asks again.
        other.js("document.querySelectorAll('[inert]').forEach((e) => e.removeAttribute('inert'))")
        other.find("[data-name='pid.kp'] input")
        other.type("pid.kp", "3")
        other.wait_for(".q-notification", "may only look")
        other.keys("u", " ")
        assert kp(ros) == 1.0
    assert "inactive" not in page.text("#mode")


def choose(page, name):
    """Choose a valve."""
    until(lambda: page.js("return !!document.querySelector('.vc-choice')?.offsetParent"), "several valves")
    page.choose(".vc-choice", name)
    until(lambda: name in page.text(".vc-choice"), f"{name} chosen")


def test_a_killed_controller_is_seen_and_its_successor_too(page, tmp_path, ros):
    valve = f"boom{next(NUMBERS)}"  # a valve that the page has not seen, also when the test is repeated
    name, namespace = f"{valve}/controller", f"/{valve}"
    with node("valve_simulator", tmp_path, namespace=namespace):
        with node("controller", tmp_path, namespace=namespace) as child:
            choose(page, valve)
            page.wait_for("#node", f"/{name}")
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
            page.click("#tab-tune")
            until(lambda: page.shown("pid.kp") == str(get_double(ros, "pid.kp", name)), "its own value")
            assert get_double(ros, "pid.kp", name) != 0.9
    choose(page, "valve")


def test_a_recording_is_begun_and_ended(page, folder):
    page.press("#record")
    page.wait_for("#record-state", "parameters of /")
    page.press("#record")
    page.wait_for("#record-state", "recorded")
    bag = Path(page.text("#record-state").split()[1])
    assert bag.parent == folder / "made" and any(path.suffix == ".mcap" for path in bag.iterdir())


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
        assert call(ros, Trigger, f"{axis}/axis_controller/stop", Trigger.Request()).success
        page.wait_for("#notice", f"{axis}/axis_controller: stopped")
        page.wait_for("#mode", "inactive")
        page.press("#reset")
        until(lambda: page.text("#notice") == "", "the end of the stop")
        until(lambda: "inactive" not in page.text("#mode"), "active again")
    choose(page, "valve")


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
    page.keys("1.25", Keys.ENTER)
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
    page.wait_for("#log", "pid.kp")
    page.click("#tab-tune")


def test_without_a_valve_the_page_says_what_is_missing(browser, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "102")
    with dashboard(tmp_path) as found:
        browser.driver.get(found)
        browser.wait_for("#notice", "No valve on the graph yet")
    browser.wait_for(".vc-live", "no connection to the dashboard; trying again")


READABLE = """
const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
const light = (rgb) => {
  const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const [r, g, b] = rgb.map((v) => linear(v / 255));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const ground = (element) => {
  const [r, g, b, alpha = 1] = numbers(getComputedStyle(element).backgroundColor);
  const below = alpha < 1 && element.parentElement ? ground(element.parentElement) : [255, 255, 255];
  return [r, g, b].map((v, k) => alpha * v + (1 - alpha) * below[k]);
};
const bad = [];
for (const element of document.querySelectorAll('body *')) {
  const text = [...element.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data).join('').trim();
  const seen = element.checkVisibility({visibilityProperty: true}) && !element.closest('[disabled]');
  if (!text || !seen) continue;
  const [a, b] = [numbers(getComputedStyle(element).color).slice(0, 3), ground(element)].map(light);
  const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  if (contrast < 4.5) bad.push(`${text.slice(0, 40)}: ${contrast.toFixed(2)}`);
}
return bad;
"""
DRAWN = """
const canvas = document.querySelector('[data-panel=voltage] canvas');
const green = getComputedStyle(canvas).getPropertyValue('--vc-green');
const colour = green.match(/\\w\\w/g).map((v) => parseInt(v, 16));
const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
for (let k = 0; k < data.length; k += 4) {
  if (data[k + 3] > 200 && colour.every((v, n) => Math.abs(v - data[k + n]) < 6)) return true;
}
return false;
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_texts_can_be_read_in_the_scheme_of_the_browser(page, scheme):
    def prefer(value):
        features = [{"name": "prefers-color-scheme", "value": value}]
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    prefer(scheme)
    try:
        page.type("pid.kp", "-3.5")
        until(lambda: page.refusal("pid.kp"), "a reason in its colour")
        grounds = {"light": "rgb(246, 247, 248)", "dark": "rgb(18, 18, 18)"}
        until(
            lambda: page.js("return getComputedStyle(document.body).backgroundColor") == grounds[scheme],
            "the ground of the scheme",
        )
        until(lambda: page.js(DRAWN), "a line in the colour of the scheme")
        for tab in ("#tab-log", "#tab-figures", "#tab-tune"):
            page.click(tab)
            until(lambda: page.js(READABLE) == [], f"texts with contrast: {page.js(READABLE)}")
    finally:
        prefer("")
