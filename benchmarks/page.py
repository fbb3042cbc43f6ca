# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.page``: what the dashboard costs the loop, with its page open in Chromium.

The cascade of the demo runs at 1 kHz, first alone, then beside the dashboard and a browser without a window
that draws command, position, error and voltage. Readings without a voltage are lost; latency is from LVDT to
voltage. Each minute the memory is told of the page's scripts (after their garbage has been collected), of the
browser's process that draws it, and of the dashboard's.
"""

import argparse
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.batch import machine
from research.campaigns import demo
from research.campaigns.processes import bar, process, run_tool, wait_until
from valve_control import outputs

WANTED = {"lost": 0.0, "latency_p50_ratio": 1.2, "page_process_cores": 0.5, "frames_per_second": 20.0}
READY = 20.0  # s for the page to show itself
MINUTE = 60.0  # s


@contextmanager
def browser(address: str) -> Iterator[Any]:
    """Chromium without a window at ``address``."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1280,950"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        driver.get(address)
        yield driver
    finally:
        driver.quit()


class Course:
    """Frames a second and memory of a page, minute by minute, taken in a thread while the loop runs."""

    def __init__(self, driver: Any, server: int) -> None:
        self._driver = driver
        self._server = psutil.Process(server)
        browser = psutil.Process(driver.service.process.pid).children(recursive=True)
        drawing = [child for child in browser if "--type=renderer" in child.cmdline()]
        self._drawing = max(drawing, key=lambda child: child.memory_info().rss)
        self._end = threading.Event()
        self.rows: list[dict[str, float]] = []
        self._thread = threading.Thread(target=self._run, name="course")

    def __enter__(self) -> "Course":
        self._begin = self._before = time.monotonic()
        self._used = self._processor_time()
        self._frames = self._drawn()
        self._take()
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()

    @property
    def cores(self) -> float:
        """Processor time of the dashboard's process for each second since the beginning."""
        return (self._processor_time() - self._used) / (time.monotonic() - self._begin)

    def _processor_time(self) -> float:
        times = self._server.cpu_times()
        return float(times.user + times.system)

    def _drawn(self) -> int:
        """Frames that the plots have drawn."""
        script = "return document.querySelector('.vc-plots')?.dataset.frames || 0"
        return int(self._driver.execute_script(script))

    def _run(self) -> None:
        minute = 1
        while not self._end.wait(max(0.0, self._begin + minute * MINUTE - time.monotonic())):
            self._take()
            minute += 1

    def _take(self) -> None:
        now, drawn = time.monotonic(), self._drawn()
        self._driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
        heap = self._driver.execute_cdp_cmd("Runtime.getHeapUsage", {})
        counters = self._driver.execute_cdp_cmd("Memory.getDOMCounters", {})
        row = {
            "minute": (now - self._begin) / MINUTE,
            "frames_per_second": (drawn - self._frames) / (now - self._before) if self.rows else float("nan"),
            "scripts_MB": 1e-6 * (heap["usedSize"] + heap.get("backingStorageSize", 0)),
            "elements": counters["nodes"],
            "browser_MB": 1e-6 * self._drawing.memory_info().rss,
            "dashboard_MB": 1e-6 * self._server.memory_info().rss,
        }
        self._before, self._frames = now, drawn
        self.rows.append(row)


def figures(run: demo.Measured) -> dict[str, float]:
    """What is told of one run; no latency where messages were lost, as it pairs them by their number."""
    p50, p99 = np.percentile(1e3 * run.latency, [50, 99]) if run.lost == 0 else (np.nan, np.nan)
    return {"samples": len(run.latency), "lost": run.lost, "latency_ms_p50": p50, "latency_ms_p99": p99}


def measured(minutes: int, folder: Path) -> dict[str, Any]:
    """Run the cascade for a minute without the page, and for ``minutes`` with it."""

    def sine(duration: float) -> demo.DemoRun:
        shape = {"scenario": "sine", "amplitude": 1.0, "frequency": 1.0, "duration": duration}
        return demo.DemoRun("page", "", ("pid.yaml", "d3fxe.yaml"), {**demo.PACE, **shape})

    seconds = minutes * MINUTE
    with bar("alone", MINUTE) as progress:
        alone = demo.run_cascade(sine(MINUTE), folder, progress)
    log = folder / "dashboard.log"
    arguments = ["-p", "port:=0", "-p", "token:=page", "-p", f"folder:={folder}/made"]
    with process("dashboard", arguments, log) as child:
        wait_until(lambda: "open http" in log.read_text(), "the dashboard's address", [child], READY)
        address = log.read_text().split("open ")[1].split()[0]
        with browser(address) as driver, Course(driver, child.pid) as course:
            with bar("with page", seconds) as progress:
                beside = demo.run_cascade(sine(seconds), folder, progress)
            cores = course.cores
    rates = [row["frames_per_second"] for row in course.rows[1:]]
    result: dict[str, Any] = {
        "machine": machine(),
        "seconds": seconds,
        "alone": figures(alone),
        "with_page": figures(beside),
        "course": course.rows,
    }
    result["figures"] = {
        "lost": result["with_page"]["lost"],
        "latency_p50_ratio": result["with_page"]["latency_ms_p50"] / result["alone"]["latency_ms_p50"],
        "page_process_cores": cores,
        "frames_per_second": min(rates),
    }
    return result


def main() -> int:
    """Measure, print, write."""
    options = argparse.ArgumentParser(prog="benchmarks.page", description=__doc__)
    options.add_argument(
        "--minutes",
        type=int,
        choices=range(1, 61),
        default=1,
        metavar="N",
        help="of the run with the page (1)",
    )
    options.add_argument("--out", default="out", metavar="FOLDER", help="output folder (out)")
    arguments = options.parse_args()
    out = Path(arguments.out)
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        print("benchmarks.page needs a browser: apt install chromium chromium-driver", file=sys.stderr)
        return 1

    def work() -> int:
        result = measured(arguments.minutes, out)
        names = list(result["course"][0])
        print("  ".join(f"{name:>17}" for name in names))
        for row in result["course"]:
            print("  ".join(f"{row[name]:17.1f}" for name in names))
        for key, value in result["figures"].items():
            wanted = f"   (wanted {WANTED[key]:g})" if key in WANTED else ""
            print(f"{key:22}{value:10.3g}{wanted}")
        outputs.write(str(out / "page.json"), outputs.as_json(result))
        print(f"wrote {out / 'page.json'}")
        return 0

    return run_tool("benchmarks.page", out, work)


if __name__ == "__main__":
    sys.exit(main())
