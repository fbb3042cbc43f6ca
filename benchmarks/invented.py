# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.invented``: from ``identify`` to tuned gains on twenty valves, without a hand.

Each valve has order 2 to 4, 3 to 40 Hz, friction up to 1.5 V, dead time up to 2 ms, noise of 1 to 15 mV.
What is run are the commands that a user types: ``identify`` on simulated data, ``tune`` of dcarc and pid
around what it has written, ``simulate`` of both on the valve itself. Motions are as fast as the valve is,
up to 14 Hz.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import tqdm

from valve_control import outputs
from valve_control.control.commands.scenarios import command, strokes
from valve_control.control.parameters import files
from valve_control.parameter import Value, Values

PERIOD = 0.001  # s
DURATION = 4.0  # s
SLOW = 6.0  # Hz  the valve of the paper, for which the motions below are made
FASTEST = 14.0  # Hz  faster motions would be cut by the limits (6), (7) of the reshaping, whatever the law
LAWS = ("dcarc", "pid")
# What identify has measured; gain, flow force, offset, static friction and drift stay open.
KNOWN = ("speed", "lvdt.delay", "lvdt.noise", "friction.coulomb")
WANTED = {"median_ratio": 0.6, "largest_ratio": 1.0}


def invented(random: np.random.Generator) -> tuple[float, Values]:
    """Bandwidth [Hz] and parameters of one valve."""
    order = int(random.integers(2, 5))
    frequency = float(np.exp(random.uniform(math.log(3.0), math.log(40.0))))
    w, damping, gain = 2.0 * math.pi * frequency, random.uniform(0.5, 1.0), random.uniform(0.6, 1.2)
    poles = np.array([1.0, 2.0 * damping * w, w * w])
    zeros = np.array([1.0])
    if order == 3:
        poles = np.polymul(poles, [1.0, w * random.uniform(3.0, 6.0)])
    if order == 4:
        fast, ratio = w * random.uniform(3.0, 5.0), random.uniform(0.9, 1.1)
        poles = np.polymul(poles, [1.0, 2.0 * random.uniform(0.3, 0.6) * fast, fast * fast])
        slower = ratio * fast
        zeros = np.array([1.0, 2.0 * random.uniform(0.4, 0.7) * slower, slower * slower])
    zeros = zeros * gain * poles[-1] / zeros[-1]
    return frequency, {
        "valve": "custom",
        "numerator": [float(x) for x in zeros],
        "denominator": [float(x) for x in poles],
        "friction.coulomb": round(float(random.uniform(0.0, 1.5)), 4),
        "friction.static_ratio": round(float(random.uniform(1.0, 1.4)), 4),
        "friction.stribeck_velocity": 0.017,
        "friction.presliding": 0.02,
        "lvdt.delay": round(float(random.uniform(0.0, 0.002)), 6),
        "lvdt.noise": round(float(random.uniform(0.001, 0.015)), 5),
    }


def motions(frequency: float) -> dict[str, np.ndarray[Any, Any]]:
    """Strokes and sines [V] for a valve of this bandwidth [Hz]."""
    t, fast = np.arange(round(DURATION / PERIOD)) * PERIOD - 0.2, min(frequency, FASTEST) / SLOW
    shape = strokes(1.2, 25.0 * fast, 1500.0 * fast * fast, 0.8)
    swell = 0.5 - 0.5 * np.cos(math.pi * np.clip(t / 0.5, 0.0, 1.0))
    return {
        "strokes": np.array([command(shape, float(time)) for time in t]),
        "sines": swell * sum(a * np.sin(2.0 * math.pi * f * fast * t) for a, f in ((0.5, 2.0), (0.25, 6.0))),
    }


def typed(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run ``valve-control`` in ``folder``."""
    return subprocess.run(
        [sys.executable, "-m", "valve_control.cli", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def gone_through(folder: Path, seed: int, budget: int) -> dict[str, Any]:
    """Identify, tune and try the valve ``seed``."""
    frequency, values = invented(np.random.default_rng(seed))
    given: dict[str, Value] = dict(values)
    about: dict[str, Any] = {"seed": seed, "frequency_hz": frequency, "valve": given}
    (folder / "true.yaml").write_text(files.as_yaml({"/**/valve_simulator": values}, []))
    for way in (["--friction", "--delay"], ["--friction"], ["--delay"], []):
        done = typed(folder, "identify", "--params-file", "true.yaml", *way, "--output", "valve.yaml")
        if done.returncode == 0:
            break
        about.setdefault("refused", []).append(done.stderr.strip().splitlines()[-1])
    else:
        return about
    about["identified_with"] = way
    moves: list[str] = []
    for name, wanted in motions(frequency).items():
        np.savetxt(folder / f"{name}.csv", wanted, fmt="%.5g")
        moves += ["--command", f"{name}.csv"]
    fixed = [word for name in KNOWN for word in ("--fix", name)]
    done = typed(
        folder, "tune", "--controller", ",".join(LAWS), "--params-file", "valve.yaml", *moves, *fixed,
        "--max-chatter", "0.25", "--budget", str(budget), "--threads", "1",
        "--output", "t.yaml", "--json", "-",
    )  # fmt: skip
    if not done.stdout:
        return {**about, "tune": done.stderr.strip().splitlines()[-1]}
    tuned = json.loads(done.stdout)["laws"]
    for law in LAWS:
        one = tuned.get(law, {"accepted": False, "reasons": ["nothing found"]})
        about[law] = {k: one.get(k) for k in ("accepted", "reasons", "verified", "margins", "chosen")}
        if one["accepted"]:
            about[law]["on_the_valve"] = [
                _on_the_valve(folder, law, f"{name}.csv") for name in motions(frequency)
            ]
    if all(about[law]["accepted"] for law in LAWS):
        dcarc, pid = (about[law] for law in LAWS)
        about["ratio"] = dcarc["verified"]["e_rms"]["median"] / pid["verified"]["e_rms"]["median"]
        on = [np.array([m["e_rms"] for m in about[law]["on_the_valve"]]) for law in LAWS]
        about["ratio_on_the_valve"] = float(np.exp(np.mean(np.log(on[0] / on[1]))))
    return about


def _on_the_valve(folder: Path, law: str, wanted: str) -> dict[str, Any]:
    done = typed(
        folder, "simulate", "--params-file", "valve.yaml", "--params-file", "true.yaml", "--params-file",
        f"t_{law}.yaml", "--command", wanted, "--json", "-",
    )  # fmt: skip
    run = json.loads(done.stdout)
    return {
        **{k: run[k] for k in ("warning", "limit_cycle") if k in run},
        "e_rms": run["true_error"]["e_rms"],
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is asked for: every law stable on its box, dcarc's error against the PID's."""
    ratios = [row["ratio"] for row in rows if "ratio" in row]
    on = [row["ratio_on_the_valve"] for row in rows if "ratio" in row]
    return {
        "valves": len(rows),
        "accepted": {law: sum(bool(row.get(law, {}).get("accepted")) for row in rows) for law in LAWS},
        "median_ratio": float(np.median(ratios)) if ratios else math.nan,
        "largest_ratio": max(ratios, default=math.nan),
        "median_ratio_on_the_valve": float(np.median(on)) if on else math.nan,
        "largest_ratio_on_the_valve": max(on, default=math.nan),
    }


def main() -> int:
    """Go through all valves, print, write."""
    options = argparse.ArgumentParser(prog="benchmarks.invented", description=__doc__)
    options.add_argument("--valves", type=int, default=20, help="(20)")
    options.add_argument("--seed", type=int, default=1, help="of the first valve (1)")
    options.add_argument("--budget", type=int, default=800, help="sets of gains of each law (800)")
    options.add_argument("--json", default="out/invented.json", metavar="FILE", help="(out/invented.json)")
    arguments = options.parse_args()
    Path(arguments.json).parent.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="valve_control-invented-") as name:

        def one(seed: int) -> dict[str, Any]:
            folder = Path(name) / str(seed)
            folder.mkdir()
            return gone_through(folder, seed, arguments.budget)

        seeds = range(arguments.seed, arguments.seed + arguments.valves)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for row in tqdm.tqdm(pool.map(one, seeds), total=len(seeds), unit="valve"):
                rows.append(row)
                result = {**summary(rows), "budget": arguments.budget, "rows": rows}
                outputs.write(arguments.json, outputs.as_json(result))
                said = " and ".join(f"{row[k]:.2f}" for k in ("ratio", "ratio_on_the_valve") if k in row)
                about = f"valve {row['seed']}: {row['frequency_hz']:.1f} Hz"
                print(f"{about}, dcarc to pid {said or '-'}", flush=True)
    for key, value in summary(rows).items():
        print(f"{key:28}{value}" + (f"   (wanted at most {WANTED[key]:g})" if key in WANTED else ""))
    print(f"wrote {arguments.json}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
