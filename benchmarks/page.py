"""``python -m benchmarks.page``: what the dashboard costs the loop, with its page open in Chromium.

The cascade of the demo runs at 1 kHz, first alone, then beside the dashboard and a browser without a window
that draws command, position, error and voltage. Readings without a voltage are lost; latency is from LVDT to
voltage.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.batch import machine
from valve_control import outputs
from valve_control.nodes.harness import demo
from valve_control.nodes.harness.processes import bar, process, run_tool, wait_until

WANTED = {"lost": 0.0, "latency_p50_ratio": 1.2, "page_process_cores": 0.5, "frames_per_second": 20.0}
READY = 20.0  # s for the page to show itself
TICK = os.sysconf("SC_CLK_TCK")  # per second of processor time


def cpu_time(pid: int) -> float:
    """Processor time [s] of a process and its threads so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


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


def heap(driver: Any) -> float:
    """Memory [MB] that the page's scripts use, after what nobody needs has been given back."""
    driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    return float(driver.execute_script("return performance.memory.usedJSHeapSize")) / 1e6


def frames(driver: Any) -> int:
    """Frames that the plots have drawn."""
    return int(driver.execute_script("return document.querySelector('.vc-plots')?.dataset.frames || 0"))


def figures(run: demo.Measured) -> dict[str, float]:
    """What is told of one run."""
    p50, p99 = np.percentile(1e3 * run.latency, [50, 99])
    return {"samples": len(run.latency), "lost": run.lost, "latency_ms_p50": p50, "latency_ms_p99": p99}


def measured(seconds: float, folder: Path) -> dict[str, Any]:
    """Run the cascade for ``seconds`` without and with the page."""
    sine = {**demo.PACE, "scenario": "sine", "amplitude": 1.0, "frequency": 1.0, "duration": seconds}
    run = demo.DemoRun("page", "", ("pid.yaml", "d3fxe.yaml"), sine)
    with bar("alone", seconds) as progress:
        alone = demo.run_cascade(run, folder, progress)
    log = folder / "dashboard.log"
    arguments = ["-p", "port:=0", "-p", "token:=page", "-p", f"folder:={folder}/made"]
    with process("dashboard", arguments, log) as child:
        wait_until(lambda: "open http" in log.read_text(), "the dashboard's address", [child], READY)
        with browser(log.read_text().split("open ")[1].split()[0]) as driver:
            begin = time.monotonic(), cpu_time(child.pid), frames(driver), heap(driver)
            with bar("with page", seconds) as progress:
                beside = demo.run_cascade(run, folder, progress)
            end = time.monotonic(), cpu_time(child.pid), frames(driver), heap(driver)
    took = end[0] - begin[0]
    result: dict[str, Any] = {
        "machine": machine(),
        "seconds": seconds,
        "alone": figures(alone),
        "with_page": figures(beside),
    }
    result["figures"] = {
        "lost": result["with_page"]["lost"],
        "latency_p50_ratio": result["with_page"]["latency_ms_p50"] / result["alone"]["latency_ms_p50"],
        "page_process_cores": (end[1] - begin[1]) / took,
        "frames_per_second": (end[2] - begin[2]) / took,
        "heap_MB_begin": begin[3],
        "heap_MB_end": end[3],
    }
    return result


def main() -> int:
    """Measure, print, write."""
    options = argparse.ArgumentParser(prog="benchmarks.page", description=__doc__)
    options.add_argument("--seconds", type=float, default=60.0, help="length of each run (60)")
    options.add_argument("--out", default="out", metavar="FOLDER", help="output folder (out)")
    arguments = options.parse_args()
    out = Path(arguments.out)
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        print("benchmarks.page needs a browser: apt install chromium chromium-driver", file=sys.stderr)
        return 1

    def work() -> int:
        with tempfile.TemporaryDirectory(prefix="valve_control-page-") as name:
            result = measured(arguments.seconds, Path(name))
        for key, value in result["figures"].items():
            wanted = f"   (wanted {WANTED[key]:g})" if key in WANTED else ""
            print(f"{key:22}{value:10.3g}{wanted}")
        outputs.write(str(out / "page.json"), outputs.as_json(result))
        print(f"wrote {out / 'page.json'}")
        return 0

    return run_tool("benchmarks.page", out, work)


if __name__ == "__main__":
    sys.exit(main())
