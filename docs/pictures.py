# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python docs/pictures.py [NAME ...]``: makes docs/figures/NAME.png for the tutorials and how-tos.

Without a name it makes all of them. Each function below is one picture. It runs the commands of its page in
a temporary folder and draws their results, or takes a picture of their report in Chromium. Two need a result
in out/, and say which command makes it. The pictures that other commands make are demo.png (``make demo``),
axes.png (``make axis``), and compare_tuned.png (``make tuned``).
"""

import contextlib
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from valve_control.control.analysis.figures import COLOURS

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(ROOT),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "83"),  # not among other nodes of this machine
    "AMENT_PREFIX_PATH": os.environ.get("AMENT_PREFIX_PATH", str(ROOT / ".venv")),
}
os.environ.update(ENVIRONMENT)
sys.path.insert(0, str(ROOT))  # benchmarks is not installed
PICTURES: dict[str, Callable[[Path], None]] = {}


def picture(function: Callable[[Path], None]) -> Callable[[Path], None]:
    """Register a function that writes the picture of its name into the file that it is given."""
    PICTURES[function.__name__] = function
    return function


# Commands


def run(*words: str) -> None:
    """Run a Python module of the project with its arguments in the present folder."""
    subprocess.run([sys.executable, "-m", *words], env=ENVIRONMENT, check=True, stdout=subprocess.DEVNULL)


def valve_control(*words: str) -> None:
    """Run ``valve-control``."""
    run("valve_control.cli", *words)


def columns(name: str) -> dict[str, Any]:
    """Columns of a CSV file with one row of names."""
    rows = np.genfromtxt(name, delimiter=",", names=True)
    return {column: rows[column] for column in rows.dtype.names}


def simulated(name: str, *words: str) -> dict[str, Any]:
    """Signals of a run of ``valve-control simulate``."""
    valve_control("simulate", *words, "--csv", f"{name}.csv")
    return columns(f"{name}.csv")


def output_of(name: str, source: str) -> Path:
    """File ``name`` in out/, which ``source`` makes. Exits with one sentence if it is not there."""
    path = ROOT / "out" / name
    if not path.exists():
        raise SystemExit(f"there is no out/{name}; {source} makes it")
    return path


def screenshot(page: str, path: Path, height: int, top: int = 0) -> None:
    """Picture of an HTML file as Chromium shows it 1000 wide, from the gap above line ``top`` on."""
    browser = shutil.which("chromium") or "chromium"
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    options += [f"--window-size=1000,{height}", f"--screenshot={path}", "--virtual-time-budget=8000"]
    address = Path(page).resolve(strict=True).as_uri()
    subprocess.run([browser, *options, address], check=True, capture_output=True, timeout=120)
    shot = plt.imread(path)
    blank = np.flatnonzero(shot[: top + 1, :, :3].min(axis=(1, 2)) > 0.99)
    plt.imsave(path, shot[blank[-1] :])


@contextlib.contextmanager
def nodes(*commands: Sequence[str]) -> Iterator[None]:
    """Run nodes as processes; SIGINT ends them, the last one first."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        for name, *arguments in commands:
            words = [sys.executable, "-m", f"valve_control.nodes.{name}", "--ros-args", *arguments]
            with open(f"{name}.log", "wb") as log:
                started.append(subprocess.Popen(words, env=ENVIRONMENT, stdout=log, stderr=log))
        yield
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGINT)
        for process in started:
            process.wait(30)


def record(bag: str) -> None:
    """Record the cascade for 14 s; oarc.ks1 changes after 5 s, the law after 8 s."""
    files = [word for name in ("d3fxe", "oarc") for word in ("--params-file", f"config/{name}.yaml")]
    settings = ("scenario:=sine", "frequency:=1.0", "amplitude:=2.0", "duration:=12.0", "listeners:=2")
    setter = [
        "nice",
        "-n",
        "3",
        sys.executable,
        str(ROOT / "docs" / "examples" / "set_parameters.py"),
        "/controller",
    ]
    with nodes(
        ["recorder", "-p", f"bag:={bag}"],
        ["valve_simulator", *files],
        ["controller", *files, "-p", "controller:=oarc"],
        ["command_source", *(word for text in settings for word in ("-p", text))],
    ):
        time.sleep(7.0)
        subprocess.run([*setter, "oarc.ks1=150.0"], env=ENVIRONMENT, check=True, timeout=20)
        time.sleep(2.0)
        subprocess.run([*setter, "controller=pid"], env=ENVIRONMENT, check=True, timeout=20)
        time.sleep(5.0)


@contextlib.contextmanager
def page(*commands: Sequence[str]) -> Iterator[Any]:
    """A browser at the dashboard beside these nodes, when it shows the gains of a PID."""
    from benchmarks.page import browser

    with nodes(["dashboard", "-p", "port:=0"], *commands):
        log = Path("dashboard.log")
        while "open http" not in log.read_text():
            time.sleep(0.1)
        with browser(log.read_text().split("open ")[1].split()[0]) as driver:
            driver.implicitly_wait(60)
            driver.find_element("css selector", "[data-name='pid.kp'] input")
            time.sleep(8.0)  # until the plots are full
            yield driver


def enter(driver: Any, name: str, text: str) -> None:
    """Type the value of a parameter into its field."""
    from selenium.webdriver import Keys

    field = driver.find_element("css selector", f"[data-name='{name}'] input")
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys(text, Keys.ENTER)


def move(topic: str, position: float) -> None:
    """Send a goal of an axis again and again for 1.5 s, in which its node comes to know of the publisher."""
    import rclpy
    from std_msgs.msg import Float64

    rclpy.init(args=[])
    publisher = rclpy.create_node("goals").create_publisher(Float64, topic, 10)
    for _ in range(15):
        publisher.publish(Float64(data=position))
        time.sleep(0.1)
    rclpy.shutdown()


# Drawing


def axes(rows: int, height: float) -> tuple[Any, list[Any]]:
    """A figure with ``rows`` plots below each other."""
    figure, grid = plt.subplots(rows, 1, figsize=(9.0, height), sharex=True, squeeze=False)
    for axis in grid[:, 0]:
        axis.grid(True, alpha=0.3)
    return figure, list(grid[:, 0])


def legend(axis: Any) -> None:
    """A legend above the plot, where it covers no data."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1, "frameon": False}
    axis.legend(ncols=len(axis.get_legend_handles_labels()[0]), fontsize="small", **place)


def save(figure: Any, path: Path) -> None:
    """Write a figure."""
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


def diagram(
    path: Path, boxes: dict[str, tuple[float, float]], arrows: Sequence[tuple[str, str, str]]
) -> None:
    """Boxes with their text at (x, y), and arrows with a text from box to box; <-> in the text: both ways."""
    xs, ys = zip(*boxes.values(), strict=True)
    figure, axis = plt.subplots(figsize=(9.0, 1.1 * (max(ys) - min(ys)) + 1.4))
    shapes = {}
    for text, (x, y) in boxes.items():
        style = {"boxstyle": "round,pad=0.6", "facecolor": "#EAF3FA", "edgecolor": COLOURS[0]}
        shapes[text] = axis.text(x, y, text, ha="center", va="center", fontsize=9, bbox=style, zorder=3)
    axis.set(xlim=(min(xs) - 0.6, max(xs) + 0.6), ylim=(min(ys) - 0.6, max(ys) + 0.6))
    axis.axis("off")
    figure.tight_layout()
    figure.canvas.draw()
    for start, end, text in arrows:
        tip: dict[str, Any] = {"arrowstyle": "<|-|>" if "<->" in text else "-|>", "color": "#333333"}
        tip["patchA"], tip["patchB"] = (shapes[name].get_bbox_patch() for name in (start, end))
        axis.annotate("", boxes[end], boxes[start], arrowprops=tip, zorder=1)
        course = axis.transData.transform(np.linspace(boxes[start], boxes[end], 200))
        inside = [tip[name].get_window_extent() for name in ("patchA", "patchB")]
        free = [at for at in course if not any(box.contains(*at) for box in inside)]
        x, y = axis.transData.inverted().transform(np.mean(free, axis=0))
        flat = boxes[start][1] == boxes[end][1]
        axis.text(
            x,
            y + (0.04 if flat else 0.0),
            text.replace("<->", "").strip(),
            ha="center",
            va="bottom" if flat else "center",
            fontsize=8,
            linespacing=1.6,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
            zorder=2,
        )
    figure.savefig(path, dpi=100)
    plt.close(figure)


# Tutorials


def my_recording() -> None:
    """Record a run and analyse it, unless this run of the script has done so."""
    if not Path("analysed.csv").exists():
        record("first_run")
        valve_control("analyze", "first_run", "--csv", "analysed.csv", "--json", "analysed.json")


def changes() -> dict[float, str]:
    """Times [s] and texts of the changes of parameters in ``analysed.json``."""
    valve = next(iter(json.loads(Path("analysed.json").read_text())["valves"].values()))
    return {
        change["time_s"]: ", ".join(f"{name} = {value}" for name, value in change["values"].items())
        for change in valve["changes"]
    }


@picture
def live_change(path: Path) -> None:
    """The cascade over DDS, its gains and its law changed while it runs."""
    my_recording()
    s = columns("analysed.csv")
    figure, (top, middle, bottom) = axes(3, 6.5)
    top.plot(s["time_s"], s["measurement_V"], color=COLOURS[0], lw=1.0, label="spool_position")
    top.plot(s["time_s"], s["command_V"], "k--", lw=1.2, label="spool_command")
    middle.plot(s["time_s"], 1e3 * s["error_V"], color=COLOURS[1], lw=0.8)
    bottom.plot(s["time_s"], s["voltage_V"], color=COLOURS[2], lw=0.8)
    for at, text in changes().items():
        for axis in (top, middle, bottom):
            axis.axvline(at, color="grey", ls="--", lw=1.0)
        bottom.annotate(text, (at, 1.0), xycoords=("data", "axes fraction"), xytext=(3, 4),
                        textcoords="offset points", fontsize=8)  # fmt: skip
    top.set_ylabel("spool [V]")
    top.set_title("cascade over DDS", loc="left")
    middle.set_ylabel("error [mV]")
    bottom.set(ylabel="valve_voltage [V]", xlabel="time [s]")
    legend(top)
    save(figure, path)


@picture
def your_valve(path: Path) -> None:
    """The laws of the tutorial on a valve that differs from its data sheet, with tuned gains."""
    sheet = ("natural_frequency=14", "damping=1", "hysteresis=5", "full_stroke=9", "lvdt.noise=0.004")
    valve_control("identify", "--data-sheet", *sheet, "lvdt.resolution=0.005", "--output", "sheet.yaml")
    motion = ("--command", "config/commands/fast_strokes.csv")
    fixed = ("friction.coulomb", "friction.static_ratio", "lvdt.noise")
    words = [word for name in fixed for word in ("--fix", name)]
    files = ("--params-file", "sheet.yaml")
    laws = ("--controller", "dcarc,pid")
    valve_control("tune", *laws, *files, *motion, *words, "--budget", "400", "--output", "tuned.yaml")
    real = ("--params-file", "docs/examples/my_valve.yaml")
    figure, (top, middle, bottom) = axes(3, 7.0)
    for law, colour in (("open_loop", "0.55"), ("pid", COLOURS[1]), ("dcarc", COLOURS[0])):
        gains = () if law == "open_loop" else ("--params-file", f"tuned_{law}.yaml")
        s = simulated(law, "--controller", law, *files, *gains, *real, *motion, "--duration", "1.0")
        error = s["measurement"] - s["command"]
        label = f"{law}: {1e3 * np.sqrt(np.mean(error**2)):.3g} mV rms"
        top.plot(s["time"], s["measurement"], color=colour, lw=1.0, label=label)
        bottom.plot(s["time"], s["voltage"], color=colour, lw=0.8)
        if law != "open_loop":
            middle.plot(s["time"], 1e3 * error, color=colour, lw=0.9)
    top.plot(s["time"], s["command"], "k--", lw=1.0, label="command")
    top.set(ylabel="LVDT reading [V]", xlim=(0.2, 0.7))
    middle.set_ylabel("error [mV]")
    bottom.set(ylabel="voltage [V]", xlabel="time [s]")
    legend(top)
    save(figure, path)


LOG = ("docs/examples/plc_log.csv", "--map", "spool_position=LVDT@4..20mA", "--map", "valve_voltage=U")


@picture
def your_log(path: Path) -> None:
    """Signals in the report of the tutorial's log."""
    valve_control("analyze", *LOG, "--html", "report.html")
    screenshot("report.html", path, 1170, 545)


@picture
def your_log_model(path: Path) -> None:
    """Frequency response of the tutorial's log, and the model."""
    valve_control("identify", *LOG, "--figure", str(path))


SOLENOID = "docs/examples/my_solenoid_valve.yaml"


@picture
def solenoid_identified(path: Path) -> None:
    """Response and coherence of the tutorial's valve with solenoids, and its fits."""
    words = ["--friction", "--output", "solenoid.yaml"]
    valve_control("identify", "--params-file", SOLENOID, *words, "--figure", str(path))


@picture
def solenoid_curve(path: Path) -> None:
    """Characteristic curve of the tutorial's valve with solenoids."""
    words = ["--friction", "--output", "solenoid.yaml"]
    valve_control("identify", "--params-file", SOLENOID, *words, "--characteristic", str(path))


# Connect


@picture
def wiring(path: Path) -> None:
    """Wiring of a card on a serial line."""
    card, stop = "card with its\nown watchdog", "emergency stop,\na switch in the\nenable line"
    boxes = {
        "controller": (0.0, 0.0), "valve_driver": (1.7, 0.0), card: (3.5, 0.0), stop: (3.5, 1.6),
        "amplifier": (5.9, 0.9), "LVDT\nconverter": (5.9, -0.8), "valve": (7.4, 0.0),
    }  # fmt: skip
    arrows = [
        ("controller", "valve_driver", "<->valve_voltage\nspool_position"),
        ("valve_driver", card, "<->serial line"),
        (card, "amplifier", "analogue output"),
        (card, stop, "enable line"),
        (stop, "amplifier", "enable line"),
        ("LVDT\nconverter", card, "analogue input"),
        ("amplifier", "valve", "coil current"),
        ("valve", "LVDT\nconverter", "spool"),
    ]
    diagram(path, boxes, arrows)


@picture
def canopen_wiring(path: Path) -> None:
    """A valve on CANopen: nodes, adapter, bus."""
    boxes = {
        "controller": (0.0, 0.0), "valve_driver\ndriver:=canopen": (2.2, 0.0), "CAN adapter": (4.2, 0.0),
        "electronics\nof the valve": (6.4, 0.0), "solenoids,\nspool, LVDT": (8.2, 0.0),
        "switch of the\nenable input": (6.4, -1.1), "supply of the\nsolenoids, switch": (8.2, -1.1),
    }  # fmt: skip
    arrows = [
        ("controller", "valve_driver\ndriver:=canopen", "<->valve_voltage\nspool_position"),
        ("valve_driver\ndriver:=canopen", "CAN adapter", "<->"),
        ("CAN adapter", "electronics\nof the valve", "<->CAN bus:\nSYNC, PDOs"),
        ("electronics\nof the valve", "solenoids,\nspool, LVDT", "<->"),
        ("switch of the\nenable input", "electronics\nof the valve", ""),
        ("supply of the\nsolenoids, switch", "solenoids,\nspool, LVDT", ""),
    ]
    diagram(path, boxes, arrows)


@picture
def modbus_wiring(path: Path) -> None:
    """Analogue I/O on Modbus TCP."""
    boxes = {
        "controller": (0.0, 0.0), "valve_driver\ndriver:=modbus": (2.4, 0.0),
        "Modbus coupler\nown watchdog 100 ms": (5.2, 0.0), "amplifier": (8.2, 0.8),
        "LVDT\nconverter": (8.2, -0.8), "valve": (9.6, 0.0),
    }  # fmt: skip
    coupler = "Modbus coupler\nown watchdog 100 ms"
    arrows = [
        ("controller", "valve_driver\ndriver:=modbus", "<->valve_voltage\nspool_position"),
        ("valve_driver\ndriver:=modbus", coupler, "<->Ethernet,\nno switch"),
        (coupler, "amplifier", "analogue output,\nenable coil"),
        ("LVDT\nconverter", coupler, "analogue input"),
        ("amplifier", "valve", ""),
        ("valve", "LVDT\nconverter", "spool"),
    ]
    diagram(path, boxes, arrows)


@picture
def hosts(path: Path) -> None:
    """Which processes belong on one host, and which may be elsewhere."""
    boxes = {
        "valve_driver": (0.0, 0.0), "controller": (1.9, 0.0), "recorder": (1.9, -1.1),
        "upper level": (4.6, 0.0), "plots, ros2 topic": (4.6, -1.1),
    }  # fmt: skip
    arrows = [
        ("valve_driver", "controller", "<->1 kHz, same host"),
        ("controller", "recorder", "same host"),
        ("upper level", "controller", "network, same ROS_DOMAIN_ID\nROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET"),
        ("controller", "plots, ros2 topic", "network"),
    ]
    diagram(path, boxes, arrows)


@picture
def priorities(path: Path) -> None:
    """Order of the real-time priorities of the processes on one host."""
    boxes = {
        "LVDT driver, amplifier\nSCHED_FIFO, highest": (0.0, 0.0), "controller\nSCHED_FIFO": (2.4, 0.0),
        "subscribers on this host\nSCHED_FIFO, lowest": (4.8, 0.0),
        "plots, ros2 topic echo\nanother host": (7.2, 0.0),
    }  # fmt: skip
    names = list(boxes)
    diagram(path, boxes, [(a, b, "higher than") for a, b in zip(names[:2], names[1:3], strict=True)])


@picture
def lockstep(path: Path) -> None:
    """Messages of two samples in lockstep."""
    lanes = ("command_source", "controller", "valve_simulator")
    messages = [
        (0, 1, "command k"), (2, 1, "reading k"), (2, 0, ""), (1, 2, "voltage k"),
        (0, 1, "command k+1"), (2, 1, "reading k+1"), (2, 0, ""), (1, 2, "voltage k+1"),
    ]  # fmt: skip
    figure, axis = plt.subplots(figsize=(9.0, 3.6))
    for lane, name in enumerate(lanes):
        axis.plot([0.0, 8.0], [-lane, -lane], color="grey", lw=1.0)
        axis.text(-0.2, -lane, name, ha="right", va="center", fontsize=9)
    for at, (start, end, text) in enumerate(messages):
        tip = {"arrowstyle": "-|>", "color": COLOURS[at // 4]}
        axis.annotate("", (at + 0.6, -end), (at, -start), arrowprops=tip)
        axis.text(at + 0.22, -(start + end) / 2, text, fontsize=8, ha="right", va="center")
    axis.set(xlim=(-1.8, 8.0), ylim=(-2.4, 0.4))
    axis.set_title("the simulator waits for voltage k before it computes reading k+1")
    axis.axis("off")
    save(figure, path)


# Measure and model


@picture
def linearised(path: Path) -> None:
    """The commands of the page: a PID on a valve with overlap and two gains, without and with the inverse."""
    valve = ["--valve", "solenoid", "--set", "solenoid.overlap=0.3"]
    valve += ["--set", "solenoid.positive=1.075", "--set", "solenoid.negative=0.925"]
    words = ["--friction", "--output", "valve.yaml"]
    valve_control("identify", *valve, *words, "--characteristic", "curve.yaml")
    figure, (top, bottom) = axes(2, 5.2)
    for i, (label, files) in enumerate((("pid", []), ("pid, linearised", ["--params-file", "curve.yaml"]))):
        words = ["--controller", "pid", "--scenario", "sine", "--set", "frequency=1.0", "--duration", "3.0"]
        s = simulated(f"run{i}", *valve, *words, "--params-file", "valve.yaml", *files)
        colour, error = COLOURS[(1, 4)[i]], 1e3 * (s["position"] - s["command"])
        top.plot(s["time"], error, color=colour, lw=1.0, label=label)
        bottom.plot(s["time"], s["voltage"], color=colour, lw=0.8)
    top.set_ylabel("error [mV]")
    top.set_title("overlap of 0.3 V, gains 15 % apart, sine of 1 Hz", loc="left")
    bottom.set(ylabel="voltage [V]", xlabel="time [s]")
    legend(top)
    save(figure, path)


# Tune


@picture
def raised_gain(path: Path) -> None:
    """Error and chatter of OARC as both feedback gains are raised, as tune.md does."""
    gains = [12.5, 25.0, 50.0, 100.0, 150.0, 200.0, 300.0, 400.0]
    indices = []
    for gain in gains:
        words = ["--controller", "oarc", "--params-file", "config/d3fxe.yaml", "--json", "gain.json"]
        valve_control("simulate", *words, "--set", f"oarc.ks1={gain}", "--set", f"oarc.ks2={gain}")
        indices.append(json.loads(Path("gain.json").read_text())["indices"])
    figure, (top, bottom) = axes(2, 5.0)
    top.loglog(gains, [1e3 * i["e_rms"] for i in indices], "o-", color=COLOURS[2])
    bottom.semilogx(gains, [i["c_u"] for i in indices], "o-", color=COLOURS[2])
    top.set_ylabel("e_rms [mV]")
    top.set_title("OARC on the valve of config/d3fxe.yaml", loc="left")
    top.set_yticks([20, 50, 100, 200, 500], ["20", "50", "100", "200", "500"])
    top.set_yticks([], minor=True)
    bottom.set(ylabel="chatter c_u", xlabel="oarc.ks1 = oarc.ks2 [1/s]")
    bottom.set_xticks(gains, [f"{gain:g}" for gain in gains], minor=False)
    bottom.set_xticks([], minor=True)
    save(figure, path)


@picture
def commissioned(path: Path) -> None:
    """Verdict and valve in the report of the tutorial, steps 1 and 2, in the folder of the repository."""
    screenshot(str(output_of("commission/report.html", "docs/tutorials/bench.md")), path, 1420)


# Simulate


@picture
def simulate(path: Path) -> None:
    """The first run of the page."""
    files = ("--params-file", "config/arc.yaml", "--params-file", "config/d3fxe.yaml")
    valve_control("simulate", "--controller", "arc", *files, "--figure", str(path))


@picture
def study(path: Path) -> None:
    """Distributions of the indices."""
    valve_control("study", "--controller", "oarc", "--valves", "10000", "--figure", str(path))


@picture
def crane_boom(path: Path) -> None:
    """The machine of the first command of the page, offline."""
    valve_control("axis", "--params-file", "config/axis/crane_boom.yaml", "--figure", str(path))


@picture
def fault_reactions(path: Path) -> None:
    """Reaction times and limits of ``make faults``."""
    rows: dict[str, list[float]] = {}  # ms: limit, then each law
    for entry in json.loads(output_of("faults.json", "make faults").read_text(encoding="utf-8")):
        if "driver" not in entry and entry["reaction_s"] is not None:
            rows.setdefault(entry["fault"], [1e3 * entry["limit_s"]]).append(1e3 * entry["reaction_s"])
    figure, axis = plt.subplots(figsize=(9.0, 6.5))
    for y, (limit, *times) in enumerate(rows.values()):
        axis.plot(
            times,
            [y] * len(times),
            "o",
            ms=4,
            alpha=0.7,
            color=COLOURS[0],
            label="" if y else "measured, each law",
        )
        axis.plot(limit, y, "|", ms=12, mew=2, color=COLOURS[1], label="" if y else "limit")
    axis.set_yticks(range(len(rows)), list(rows), fontsize=8)
    axis.invert_yaxis()
    axis.set(xscale="log", xlabel="reaction time [ms]")
    axis.grid(True, alpha=0.3)
    legend(axis)
    save(figure, path)


# Watch

CALM = ("sample_period:=0.005", "lvdt.hold_samples:=2000", "lvdt.period_limit:=1000.0", "pid.kd:=0.0",
        "lvdt.frozen_samples:=0", "lvdt.max_rate:=1e7", "controller:=pid",
        "pid.form:=plain", "pid.kp:=1.0", "pid.ki:=20.0")  # fmt: skip
CALM_VALVE = ("sample_period:=0.005", "voltage_timeout:=0.0", "patience:=0.2", "friction.coulomb:=0.2")
SLOW_SINE = ("sample_period:=0.005", "scenario:=sine", "frequency:=0.5", "amplitude:=1.0", "duration:=600.0")


def calm_valve() -> list[list[str]]:
    """A valve at 200 Hz, which bears the pauses that a browser makes on a small machine."""
    valve = ("--params-file", "config/d3fxe.yaml")
    return [
        ["valve_simulator", *valve, *(word for text in CALM_VALVE for word in ("-p", text))],
        ["controller", *valve, *(word for text in CALM for word in ("-p", text))],
        ["command_source", *(word for text in SLOW_SINE for word in ("-p", text))],
    ]


@picture
def dashboard_tune(path: Path) -> None:
    """The page of a valve; a gain has been changed."""
    with page(*calm_valve()) as driver:
        enter(driver, "pid.kp", "1.5")
        time.sleep(3.0)
        driver.execute_script("document.activeElement.blur(); scrollTo(0, 0)")
        time.sleep(1.0)
        driver.save_screenshot(str(path))


@picture
def dashboard_refused(path: Path) -> None:
    """A value out of range, and one that the node refuses."""
    with page(*calm_valve()) as driver:
        enter(driver, "pid.kp", "-3.5")
        enter(driver, "pid.break_frequency", "0.1")
        time.sleep(3.0)
        driver.execute_script("scrollTo(0, 400)")
        time.sleep(1.0)
        driver.save_screenshot(str(path))


@picture
def dashboard_axis(path: Path) -> None:
    """The page of a valve that moves an axis."""
    machine = ("-r", "__ns:=/boom", "--params-file", "config/axis/bench.yaml")
    with page(
        ["axis_simulator", *machine, "-p", "clock:=lockstep"],
        ["controller", *machine, "-p", "lockstep:=true", "-p", "lvdt.frozen_samples:=0"],
        ["axis_controller", *machine, "-p", "lockstep:=true"],
    ) as driver:
        for goal in 3 * (0.3, 0.2):
            move("/boom/goal_position", goal)
        driver.execute_script("scrollTo(0, 200)")
        move("/boom/goal_position", 0.3)
        driver.save_screenshot(str(path))


# Record


@picture
def analysis(path: Path) -> None:
    """Head of the report of analyze."""
    my_recording()
    valve_control("analyze", "first_run", "--html", "first_run.html")
    screenshot("first_run.html", path, 1690, 205)


@picture
def recorded_command(path: Path) -> None:
    """The recorded loop, and a simulated one on the recorded command."""
    my_recording()
    words = ["--command", "first_run", "--controller", "dcarc", "--params-file", "config/d3fxe.yaml"]
    recorded = {name.removesuffix("_V"): values for name, values in columns("analysed.csv").items()}
    recorded["time"] = recorded["time_s"]
    figure, (top, middle, bottom) = axes(3, 6.5)
    for label, colour, run in (
        ("recorded", "0.55", recorded),
        ("simulated dcarc", COLOURS[0], simulated("dcarc", *words)),
    ):
        shown = (run["time"] >= 7.0) & (run["time"] < 10.0)
        s = {name: values[shown] for name, values in run.items()}
        top.plot(s["time"], s["measurement"], color=colour, lw=1.0, label=label)
        middle.plot(s["time"], 1e3 * (s["measurement"] - s["command"]), color=colour, lw=0.8)
        bottom.plot(s["time"], s["voltage"], color=colour, lw=0.7)
    top.plot(s["time"], s["command"], "k--", lw=1.0, label="command")
    top.set_ylabel("spool [V]")
    top.set_title("three seconds of the recording", loc="left")
    middle.set_ylabel("error [mV]")
    bottom.set(ylabel="voltage [V]", xlabel="time [s]")
    legend(top)
    save(figure, path)


@picture
def recovered(path: Path) -> None:
    """The readings of a bag with two damaged chunks that recover has saved."""
    my_recording()
    shutil.copytree("first_run", "damaged", dirs_exist_ok=True)
    file = next(Path("damaged").glob("*.mcap"))
    data = bytearray(file.read_bytes())
    for part in (0.35, 0.6):
        data[int(part * len(data))] ^= 0xFF
    file.write_bytes(data)
    valve_control("bag", "recover", "damaged")
    valve_control("analyze", "damaged_recovered", "--csv", "saved.csv")
    whole, saved = columns("analysed.csv"), columns("saved.csv")
    figure, (axis,) = axes(1, 3.4)
    axis.plot(whole["time_s"], whole["measurement_V"], color="silver", lw=3.0, label="recorded")
    stamps = np.isin(whole["stamp_ns"], saved["stamp_ns"])
    axis.plot(whole["time_s"], np.where(stamps, whole["measurement_V"], np.nan), color=COLOURS[0], lw=1.0,
              label="after recover")  # fmt: skip
    lost = whole["time_s"][~stamps]
    if len(lost) == 0:
        raise ValueError("nothing was lost; damage more of the bag")
    axis.set(xlim=(lost[0] - 1.0, lost[-1] + 1.0), ylabel="spool_position [V]", xlabel="time [s]")
    axis.set_title(f"two damaged chunks, {len(lost)} readings lost", loc="left")
    legend(axis)
    save(figure, path)


# Extend and verify


@picture
def lead_law(path: Path) -> None:
    """The example law on the paper's valve, beside open loop."""
    words = ["pip", "install", "--quiet", "--no-build-isolation", "--no-deps", "--target", "plugin"]
    shutil.copytree(ROOT / "docs" / "examples" / "lead_law", "lead_law")  # pip builds in it
    subprocess.run([sys.executable, "-m", *words, "./lead_law"], check=True)
    ENVIRONMENT["PYTHONPATH"] = f"{ROOT}{os.pathsep}{Path('plugin').resolve()}"
    figure, (top, bottom) = axes(2, 5.2)
    for law, colour, *words in (("open_loop", "0.55"), ("lead", COLOURS[5], "--set", "lead.gain=3.0")):
        s = simulated(law, "--controller", law, *words)
        top.plot(s["time"], s["position"], color=colour, lw=1.0, label=law)
        bottom.plot(s["time"], 1e3 * (s["position"] - s["command"]), color=colour, lw=1.0)
    top.plot(s["time"], s["command"], "k--", lw=1.0, label="command")
    top.set_ylabel("spool [V]")
    top.set_title("lead.gain = 3.0", loc="left")
    bottom.set(ylabel="error [mV]", xlabel="time [s]")
    legend(top)
    save(figure, path)


@picture
def exported_watch(path: Path) -> None:
    """The recorded run that an exported law is compared with: its readings and voltages."""
    valve_control("export", "--controller", "oarc", "--watch", "--output", "oarc_watched")
    with open("oarc_watched/check.csv", newline="", encoding="utf-8") as stream:
        rows = [(float(r["a"]), float(r["result"])) for r in csv.DictReader(stream) if r["event"] == "sample"]
    reading, voltage = np.array(rows).T
    figure, (top, bottom) = axes(2, 5.0)
    top.plot(reading, ".", ms=1.5, color=COLOURS[0])
    bottom.plot(voltage, color=COLOURS[2], lw=0.6)
    top.set(ylabel="reading [V]", ylim=(-12.0, 12.0))
    top.set_title("run of check.csv, with its faults", loc="left")
    bottom.set(ylabel="voltage [V]", xlabel="sample")
    save(figure, path)


@picture
def paper(path: Path) -> None:
    """Head of the page with the paper's Table 1."""
    run("research.paper", "--offline", "--out", "paper")
    screenshot("paper/index.html", path, 1190)


def main(names: Sequence[str]) -> int:
    """Make the pictures ``names``, all if it is empty; returns the exit status."""
    if unknown := sorted(set(names) - set(PICTURES)):
        print(f"there is no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name in ("config", "docs"):
            Path(name).symlink_to(ROOT / name)
        for name in names or PICTURES:
            path = FIGURES / f"{name}.png"
            PICTURES[name](path)
            print(f"wrote docs/figures/{path.name}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
