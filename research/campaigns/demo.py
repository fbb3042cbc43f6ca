# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the demo: the cascade of three processes over DDS, for each controller in turn."""

import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from research.campaigns.processes import (
    TOPICS,
    Listener,
    bar,
    node_arguments,
    node_values,
    parse_tool,
    process,
    run_tool,
    tool_options,
    wait_until,
)
from research.paper import PAPER_TABLE_1
from valve_control import outputs
from valve_control.arrays import Floats
from valve_control.cli import demo
from valve_control.control.analysis import limit_cycle
from valve_control.control.analysis.figures import Trace, draw_traces
from valve_control.control.analysis.indices import HEADER, Indices, index_row, indices
from valve_control.control.parameters import build
from valve_control.control.simulation import offline
from valve_control.parameter import Values

SHIFT_SAMPLES = 200  # over which readings and voltages are matched
PARTIES = ("controller", "valve_simulator", "command_source")
MOST_OUT = 0.8  # share of the time that pauses may take
MOST_OFF = 0.2  # share of the time at 0 V up to which a run shows its law; a slow sine is at rest at first
LEAST_RATE = 0.9  # of the readings that should come
STANDSTILL = 0.02  # s; after a longer pause of the machine a run is repeated once
PAUSE = 0.01  # s; what follows a longer pause shows the machine, not the law,
RECOVERY = 0.3  # s  ... for so long
SETTLE = 0.5  # s of the closed loop at rest before the command begins


class DemoRun(NamedTuple):
    """One run of the cascade: law, files of parameters, settings."""

    name: str
    group: str
    files: tuple[str, ...]
    settings: dict[str, Any]  # of the command source and of the valve, over the files


STORY = "a slow, sticky valve"
TABLE_1 = "the paper's valve, point to point (Table 1, Fig. 5)"
# The controller and the demo itself listen; the upper level has a clock of its own.
# A desktop may put a process aside for tens of milliseconds, which is not what the demo is about.
PACE = {"listeners": 2, "trigger": "timer", "lvdt.hold_samples": 100, "duration": 6.0}
RUNS = (
    *(DemoRun(law, STORY, demo.files_of(law), {**PACE, **demo.motion()}) for law in demo.LAWS),
    *(
        DemoRun(f"paper_{law}", TABLE_1, (f"{law}.yaml", "d3fxe_experiment.yaml"), PACE)
        for law in ("arc", "oarc", "pid")
    ),
)


class Measured(NamedTuple):
    """What the listener received during the command, and its latencies."""

    period: float  # s
    command: Floats  # V
    measurement: Floats  # V
    voltage: Floats  # V
    latency: Floats  # s, from publication of the reading to publication of its voltage
    lost: int  # LVDT readings without a voltage
    rate: float  # LVDT readings per second
    lead: int  # voltages that the controller had published before the first command
    joined: int  # readings that the simulator had published before the controller's first voltage
    held: float  # V, where the controller held the spool before the first command
    pause: float  # s, longest between two commands, readings or voltages
    steady: npt.NDArray[np.bool_]  # samples that no pause of the machine reaches


def values_of(run: DemoRun) -> dict[str, Values]:
    """All parameters of the three nodes in ``run``. Raises ParameterError."""
    return {node: node_values(node, run.files, run.settings) for node in PARTIES}


def answer_shift(reading_times: Floats, voltage_times: Floats) -> int:
    """By how many entries the first of ``reading_times`` [s] lies before its answer in ``voltage_times``.

    One voltage answers one reading, so the shift is constant as long as none is lost; it is the one with
    which voltages follow readings after the shortest positive median time.
    """
    near = int(np.searchsorted(voltage_times, reading_times[0]))
    n = min(SHIFT_SAMPLES, len(reading_times), len(voltage_times) - near - 5)  # the last may have no answer
    lags = {
        shift: float(np.median(voltage_times[shift : shift + n] - reading_times[:n]))
        for shift in range(max(0, near - 5), near + 6)
        if n > 0
    }
    answered = [shift for shift, lag in lags.items() if lag > 0.0]
    if not answered:
        raise RuntimeError(
            "too many messages were lost to compare; is something else keeping the cores busy?"
        )
    return min(answered, key=lags.__getitem__)


def command_topic(topics: Iterable[str]) -> str:
    """The one of ``topics`` that has the command."""
    return next(topic for topic in topics if topic in ("spool_command", "spool_trajectory"))


def measure(listener: Listener, period: float, duration: float) -> Measured:
    """Align the three topics over ``duration`` [s] from the first command on."""
    commands, command_times = listener.arrays(command_topic(listener.values))
    readings, reading_times = listener.arrays("spool_position")
    voltages, voltage_times = listener.arrays("valve_voltage")
    inside = np.flatnonzero(
        (reading_times >= command_times[0]) & (reading_times < command_times[0] + duration)
    )
    first = answer_shift(reading_times[inside], voltage_times)
    last = answer_shift(reading_times[inside[-SHIFT_SAMPLES:]], voltage_times)
    lost = len(inside) - min(SHIFT_SAMPLES, len(inside)) - (last - first)
    answers = np.minimum(first + np.arange(len(inside)), len(voltages) - 1)
    reading_number = listener.sequence["spool_position"][int(inside[0])]
    voltage_number = listener.sequence["valve_voltage"][first]
    begin, end = float(reading_times[inside[0]]), float(reading_times[inside[-1]])
    latency = voltage_times[answers] - reading_times[inside]
    paced = [
        stamps[(stamps >= begin) & (stamps <= end)]
        for stamps in (command_times, reading_times, voltage_times)
    ]
    return Measured(
        period=period,
        command=np.interp(reading_times[inside], command_times, commands),  # the motion at that time
        measurement=readings[inside],
        voltage=voltages[answers],
        latency=latency,
        lost=lost,
        rate=(len(inside) - 1) / (end - begin),
        lead=voltage_number - 1,
        joined=max(0, reading_number - voltage_number),  # 0 V while the LVDT is silent answers no reading
        held=float(np.median(readings[reading_times < command_times[0]][-SHIFT_SAMPLES:])),
        pause=max(float(np.max(np.diff(stamps))) for stamps in paced),
        steady=steady(reading_times[inside], paced) & (latency <= PAUSE),
    )


def steady(times: Floats, paced: Sequence[Floats]) -> npt.NDArray[np.bool_]:
    """Which of ``times`` [s] lie neither in a pause of ``paced`` stamps [s] nor shortly after it."""
    mask = np.ones(len(times), dtype=np.bool_)
    for stamps in paced:
        for i in np.flatnonzero(np.diff(stamps) > PAUSE):
            mask &= (times < stamps[i]) | (times > stamps[i + 1] + RECOVERY)
    return mask


def run_cascade(run: DemoRun, folder: Path, progress: tqdm) -> Measured:
    """Start the three nodes, let the command run through once, stop them; returns what was measured."""
    values = values_of(run)
    duration = float(str(values["command_source"]["duration"]))
    period = float(str(values["controller"]["sample_period"]))
    log = {node: folder / f"{run.name}_{node}.log" for node in PARTIES}
    points = run.settings.get("message") == "trajectory"
    listener = Listener("demo", ("spool_trajectory" if points else "spool_command", *TOPICS[1:]))
    try:
        with process(
            "controller", node_arguments("controller", run.files, run.settings), log["controller"]
        ) as controller:
            with process(
                "valve_simulator",
                node_arguments("valve_simulator", run.files, run.settings),
                log["valve_simulator"],
            ) as simulator:
                children = [controller, simulator]
                need = round(SETTLE / period)

                def closed() -> bool:
                    listener.fetch()
                    return all(len(listener.values[topic]) >= need for topic in TOPICS[1:])

                wait_until(closed, "the closed loop", children)
                with process(
                    "command_source",
                    node_arguments("command_source", run.files, run.settings),
                    log["command_source"],
                ) as source:
                    children.append(source)

                    def begun() -> bool:
                        listener.fetch()
                        return len(listener.values[command_topic(listener.values)]) > 0

                    wait_until(begun, "the command", children)
                    _watch(listener, duration, progress, children)
            _drain(listener)
        return measure(listener, period, duration)
    finally:
        listener.destroy_node()


def _watch(listener: Listener, duration: float, progress: tqdm, children: list[Any]) -> None:
    began = time.monotonic()
    shown = 0.0
    while shown < duration:
        time.sleep(0.1)
        listener.fetch()
        if any(child.poll() is not None for child in children):
            raise RuntimeError("a node ended in the middle of the run; see its log in the output folder")
        now = min(time.monotonic() - began, duration)
        progress.update(now - shown)
        shown = now
    time.sleep(0.2)
    listener.fetch()


def _drain(listener: Listener) -> None:
    """Fetch messages until every reading has its voltage, or nothing more comes."""
    for _ in range(20):
        listener.fetch()
        if len(listener.values["valve_voltage"]) >= len(listener.values["spool_position"]):
            return
        time.sleep(0.02)


def offline_twin(run: DemoRun, measured: Measured) -> tuple[Indices, str]:
    """Indices of the same run without middleware: same LVDT noise, held for as long, same samples left out.

    Beside them the warning of law and valve, "" if there is none.
    """
    values = values_of(run)
    waiting = np.full(measured.lead, measured.held)
    command = np.concatenate([waiting, build.commands(values["command_source"])])
    points = values["command_source"]["message"] == "trajectory"
    twin = offline.simulate(
        values["controller"],
        values["valve_simulator"],
        command,
        noise_start=measured.joined,
        derivatives=build.derivatives(command, measured.period) if points else None,
    )
    error, voltage = (twin.measurement - twin.command)[measured.lead :], twin.voltage[measured.lead :]
    kept = np.ones(len(error), dtype=np.bool_)
    common = min(len(error), len(measured.steady))
    kept[:common] = measured.steady[:common]
    return indices(error, voltage, twin.period, kept), twin.warning


def disturbed(name: str, run: Measured) -> str:
    """Why the run does not show what the law does, "" if it does."""
    out, wanted = float(np.mean(~run.steady)), 1.0 / run.period
    off = float(np.mean(run.voltage == 0.0))
    if out <= MOST_OUT and off <= MOST_OFF and run.rate >= LEAST_RATE * wanted:
        return ""
    return (
        f"{name}: {100.0 * out:.0f} % of the time in pauses of the machine (the longest "
        f"{1e3 * run.pause:.0f} ms), 0 V for {100.0 * off:.0f} %, {run.rate:.0f} readings a second instead "
        f"of {wanted:.0f}: this run does not show the law (is something else keeping the cores busy? "
        f"{name}_controller.log tells when it was switched off)"
    )


def _left_out(measured: Measured) -> float:
    """Time [s] that pauses of the machine take from the run."""
    return measured.period * int(np.count_nonzero(~measured.steady))


def _beside_twin(run: DemoRun, measured: Measured) -> dict[str, Any]:
    """Print the indices of a run, of its offline twin and of the paper; all of it for JSON."""
    error = measured.measurement - measured.command
    over_dds = indices(error, measured.voltage, measured.period, measured.steady)
    twin, warning = offline_twin(run, measured)
    law = values_of(run)["controller"]
    saturated = float(np.mean(np.abs(measured.voltage) >= float(str(law["u_max"]))))
    least = float(str(law["oscillation_limit"]))
    cycle = limit_cycle.limit_cycle(measured.voltage, measured.command, measured.period, least)
    worst = max(abs(a / b - 1.0) for a, b in zip(over_dds, twin, strict=True) if b != 0.0)
    print(index_row(run.name, over_dds))
    print(index_row("  offline", twin))
    paper = PAPER_TABLE_1.get(run.name.removeprefix("paper_")) if run.group == TABLE_1 else None
    if paper is not None:
        print(index_row("  paper", paper))
    said = limit_cycle.in_words(saturated, cycle)
    if said:
        print(f"{run.name}: {said}")
    if warning:
        print(f"warning: {warning}", file=sys.stderr)
    p50, p99 = np.percentile(measured.latency, [50, 99])
    return {
        "controller": run.name,
        "scenario": run.group,
        "indices": over_dds._asdict(),
        "offline": twin._asdict(),
        "paper": paper._asdict() if paper is not None else None,
        "worst_deviation_from_offline": worst,
        **limit_cycle.as_dict(saturated, cycle),
        "warning": warning or None,
        "samples": len(measured.measurement),
        "lost": measured.lost,
        "longest_pause_s": measured.pause,
        "left_out_s": _left_out(measured),
        "rate_hz": measured.rate,
        "latency_s": {"p50": p50, "p99": p99, "max": float(np.max(measured.latency))},
    }


def _print_timing(result: list[dict[str, Any]]) -> None:
    """Print rates and latencies, and how far the indices are from those of the offline runs."""
    print(
        f"\n{'':14}{'rate [Hz]':>10}{'samples':>9}{'lost':>6}"
        f"{'LVDT to voltage [ms]: p50':>28}{'p99':>8}{'max':>8}"
    )
    for entry in result:
        ms = {k: 1e3 * v for k, v in entry["latency_s"].items()}
        print(
            f"{entry['controller']:14}{entry['rate_hz']:10.1f}{entry['samples']:9d}{entry['lost']:6d}"
            f"{ms['p50']:28.3f}{ms['p99']:8.3f}{ms['max']:8.3f}"
        )
    print()
    for entry in result:
        print(
            f"{entry['controller']}: largest deviation of an index from the offline run "
            f"{100.0 * entry['worst_deviation_from_offline']:.1f} % "
            f"(longest pause {1e3 * entry['longest_pause_s']:.1f} ms"
            + (
                f"; {entry['left_out_s']:.1f} s after pauses of the machine left out)"
                if entry["left_out_s"]
                else ")"
            )
        )


def report(runs: list[tuple[DemoRun, Measured]], folder: Path) -> bool:
    """Print the tables, write JSON and figure; whether all runs show what the laws do."""
    complaints = [disturbed(run.name, measured) for run, measured in runs]
    runs = [one for one, complaint in zip(runs, complaints, strict=True) if not complaint]
    print(f"\n{HEADER}")
    result = [_beside_twin(run, measured) for run, measured in runs]
    _print_timing(result)
    outputs.write(str(folder / "demo.json"), outputs.as_json(result))
    groups: dict[str, dict[str, Trace]] = {}
    for run, measured in runs:
        time_axis = np.arange(len(measured.command), dtype=np.float64) / measured.rate
        groups.setdefault(run.group, {})[run.name.removeprefix("paper_")] = Trace(
            time_axis, measured.command, measured.measurement, measured.voltage
        )
    written = [folder / "demo.json"]
    if paper := groups.get(TABLE_1):
        written.append(folder / "demo_paper.png")
        draw_traces(written[-1:], paper, f"{TABLE_1}: three processes over DDS at 1 kHz")
    if story := groups.get(STORY):
        print(f"\n{demo.HEAD}")
        errors = {}
        for law, trace in story.items():
            text, errors[law] = demo.line(law, trace)
            print(text)
        if demo.DRAWN.keys() & story.keys():
            written.append(folder / "demo.png")
            demo.draw(str(written[-1]), story, errors, "three ROS 2 processes at 1 kHz")
    print(f"\nwrote {', '.join(map(str, reversed(written)))} and the nodes' logs")
    for text in filter(None, complaints):
        print(text, file=sys.stderr)
    return not any(complaints)


def main() -> int:
    """Entry point of `make demo`."""
    arguments = parse_tool(tool_options("demo", __doc__, [run.name for run in RUNS]))
    folder = Path(arguments.out)
    runs = [run for run in RUNS if arguments.only is None or run.name in arguments.only]

    def work() -> int:
        done = []
        for run in runs:
            duration = float(str(values_of(run)["command_source"]["duration"]))
            with bar(run.name, duration) as progress:
                measured = run_cascade(run, folder, progress)
            if measured.pause > STANDSTILL:
                stood = f"{1e3 * measured.pause:.0f} ms"
                print(f"{run.name}: the machine stood still for {stood}; it runs again", file=sys.stderr)
                with bar(run.name, duration) as progress:
                    measured = min(measured, run_cascade(run, folder, progress), key=_left_out)
            done.append((run, measured))
        return 0 if report(done, folder) else 1

    return run_tool("demo", folder, work)


if __name__ == "__main__":
    sys.exit(main())
