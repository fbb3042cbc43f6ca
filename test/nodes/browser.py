# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A real browser for the tests of the dashboard: Chromium without a window, driven by selenium."""

import json
import shutil
import time
import urllib.request
from contextlib import contextmanager

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRIVER = shutil.which("chromedriver")
NEEDED = "no browser for the dashboard's tests: apt install chromium chromium-driver"
LIMIT = 40.0  # s

needs_browser = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason=NEEDED)


def until(condition, what, limit=LIMIT):
    """The first true value of ``condition``."""
    end = time.monotonic() + limit
    while not (value := condition()):
        assert time.monotonic() < end, f"{what} not within {limit} s"
        time.sleep(0.05)
    return value


class Window:
    """One window of the browser."""

    def __init__(self, driver):
        self.driver = driver

    def open(self, address):
        self.driver.get(address)
        until(lambda: int(self.plots().get("frames", 0)) > 3, f"frames in {address}: {self.text('body')}")

    def js(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def plots(self):
        """What the plots say of themselves."""
        return self.js("const e = document.querySelector('.vc-plots'); return e ? {...e.dataset} : {}")

    def find(self, selector):
        try:
            return until(lambda: self.driver.find_elements("css selector", selector), selector)[0]
        except AssertionError as error:
            raise AssertionError(f"{error} in: {self.text('body')}") from None

    def act(self, selector, action):
        """Do something with an element, again with its successor if the page draws it anew meanwhile."""
        from selenium.common.exceptions import WebDriverException

        def done():
            element = self.find(selector)
            try:
                self.js("arguments[0].scrollIntoView({block: 'center'})", element)
                action(element)
            except WebDriverException:  # it moves yet
                return False
            return True

        until(done, f"{selector} that stays")

    def text(self, selector):
        return self.js(
            "const e = document.querySelector(arguments[0]); return e ? e.innerText : ''", selector
        )

    def wait_for(self, selector, word, limit=LIMIT):
        """Wait for ``word`` in an element that is seen."""
        until(lambda: word in self.text(selector), f"'{word}' in {selector}: {self.text(selector)}", limit)

    def click(self, selector):
        self.act(selector, lambda element: element.click())

    def enabled(self, selector):
        return self.js(
            "const e = document.querySelector(arguments[0]);"
            "return !!e && !e.disabled && !e.closest('[inert]')",
            selector,
        )

    def press(self, selector):
        """Click a button as soon as it can be clicked."""
        until(lambda: self.enabled(selector), f"{selector} enabled")
        self.click(selector)

    def keys(self, *keys):
        """Type into whatever has the focus."""
        from selenium.webdriver import ActionChains

        ActionChains(self.driver).send_keys(*keys).perform()

    def select_all(self):
        """Select all that stands in the field with the focus."""
        from selenium.webdriver import ActionChains, Keys

        ActionChains(self.driver).key_down(Keys.CONTROL).send_keys("a").key_up(Keys.CONTROL).perform()

    def drag(self, slider, thumb, share):
        """Draw a slider's thumb to a ``share`` of its length with the mouse, in several moves."""
        from selenium.webdriver import ActionChains

        self.js("arguments[0].scrollIntoView({block: 'center'})", slider)
        box, at = (
            self.js("return arguments[0].getBoundingClientRect().toJSON()", e) for e in (slider, thumb)
        )
        way = box["left"] + share * box["width"] - (at["left"] + at["width"] / 2)
        chain = ActionChains(self.driver).click_and_hold(thumb)
        for _ in range(5):
            chain.move_by_offset(round(way / 5), 0).pause(0.1)
        chain.release().perform()

    def blur(self):
        self.js("document.activeElement.blur()")

    def write(self, selector, *keys):
        """Replace all that stands in a field by what ``keys`` type."""
        from selenium.webdriver import Keys

        def typed(entry):
            entry.click()
            entry.send_keys(Keys.CONTROL, "a")
            entry.send_keys(*keys)

        self.act(selector, typed)
        self.blur()

    def shown(self, name):
        """Text in a parameter's field, None while the page has no such field."""
        return self.js(
            "return document.querySelector(arguments[0])?.value ?? null", f"[data-name='{name}'] input"
        )

    def type(self, name, text):
        """Type a value into a field, and Enter."""
        from selenium.webdriver import Keys

        self.write(f"[data-name='{name}'] input", text, Keys.ENTER)

    def fill(self, name, text):
        """Put a text into the field with the id ``name``."""
        self.write(f"#{name} input, input#{name}", text)

    def choose(self, selector, word):
        """Choose an entry of a list."""
        self.click(selector)

        def item():
            items = self.driver.find_elements("css selector", ".q-menu .q-item")
            return next((i for i in items if i.text == word), None)

        until(item, f"{word} in {selector}").click()

    def refusal(self, name):
        return self.text(f"[data-name='{name}'] .vc-refusal")

    def figure(self, name):
        """One of the indices of the last seconds, NaN while there are none."""
        words = self.text("#indices").split()
        return float(words[words.index(name) + 1]) if name in words else float("nan")

    def requests(self):
        """Addresses of all that the browser has asked for since the last call."""
        found = []
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                found.append(message["params"]["request"]["url"])
            elif message["method"] == "Network.webSocketCreated":
                found.append(message["params"]["url"])
        return found


PHONE = {
    "width": 390,
    "height": 844,
    "deviceScaleFactor": 2,
    "mobile": True,
}  # narrower than Chromium's windows


@contextmanager
def window(size="1280,950", screen=None):
    """A window of a browser of its own, which has no network but this host; ``screen``: that of a device."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", f"--window-size={size}",
        "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1", "--disable-background-networking",
    ):  # fmt: skip
        options.add_argument(argument)
    options.page_load_strategy = "eager"
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        if screen:
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        yield Window(driver)
    finally:
        driver.quit()


def get(address, **headers):
    """Status and text of a page."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=20.0) as answer:
            return answer.status, answer.read().decode(errors="replace")
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode(errors="replace")
