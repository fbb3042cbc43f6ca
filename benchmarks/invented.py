# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.invented``: from ``identify`` to tuned gains on twenty valves, without a hand.

Each valve has order 2 to 4, 3 to 40 Hz, friction up to 1.5 V, dead time up to 2 ms, noise of 1 to 15 mV.
What is run are the commands that a user types: ``identify`` on simulated data, ``tune`` of dcarc and pid
around what it has written, ``simulate`` of both on the valve itself. Motions are as fast as the valve is,
up to 14 Hz.

``--drawn`` tunes dcarc, arc, oarc and pid with the default options around random valves instead, of model (3)
and with solenoids in turn. Each row goes to a file as soon as it is there.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import tqdm

from benchmarks import solenoid
from valve_control import outputs
from valve_control.control.commands.scenarios import command, strokes
from valve_control.control.parameters import ros_file
from valve_control.parameter import Value, Values

PERIOD = 0.001  # s
DURATION = 4.0  # s
SLOW = 6.0  # Hz  the valve of the paper, for which the motions below are made
FASTEST = 14.0  # Hz  faster motions would be cut by the limits (6), (7) of the reshaping, whatever the law
LAWS = ("dcarc", "pid")
# What identify has measured; gain, flow force, offset, static friction and drift stay open.
KNOWN = ("speed", "lvdt.delay", "lvdt.noise", "friction.coulomb")
WANTED = {"median_ratio": 0.6, "largest_ratio": 1.0}
ALL = ("dcarc", "arc", "oarc", "pid")
WITHIN = 0.05  # of overshoot, by default


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
    (folder / "true.yaml").write_text(ros_file.as_yaml({"/**/valve_simulator": values}, []))
    for way in (["--friction"], []):
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


def drawn(seed: int) -> Values:
    """A random valve: of model (3) with friction for even seeds, with solenoids for odd ones."""
    if seed % 2:
        return solenoid.drawn(seed)
    random = np.random.default_rng(seed)
    low_high = {
        "gain_scale": (0.7, 1.4),
        "friction.coulomb": (0.0, 1.6),
        "friction.static_ratio": (1.0, 1.6),
        "friction.presliding": (0.01, 0.04),
        "flow_force": (-0.3, 0.3),
        "disturbance.offset": (-0.5, 0.5),
        "lvdt.noise": (0.001, 0.008),
        "lvdt.delay": (0.0, 0.001),
    }
    own: dict[str, Value] = {name: float(random.uniform(*ends)) for name, ends in low_high.items()}
    return {"valve": "fourth_order", "friction.stribeck_velocity": 0.03, "lvdt.resolution": 0.003, **own}


def tuned(folder: Path, seed: int, budget: int) -> dict[str, Any]:
    """What ``tune`` makes of the valve ``seed`` with default options, and of each law."""
    began = time.monotonic()
    (folder / "valve.yaml").write_text(ros_file.as_yaml({"/**/valve_simulator": drawn(seed)}, []))
    done = typed(
        folder, "tune", "--controller", ",".join(ALL), "--params-file", "valve.yaml", "--budget", str(budget),
        "--threads", "1", "--json", "-",
    )  # fmt: skip
    row: dict[str, Any] = {"seed": seed, "status": done.returncode, "seconds": time.monotonic() - began}
    if not done.stdout:
        return {**row, "refused": done.stderr.strip().splitlines()[-1]}
    laws = json.loads(done.stdout)["laws"]
    for law, one in laws.items():
        kept = ("accepted", "reasons", "notes", "verified", "limits", "chosen", "front")
        row[law] = {name: one[name] for name in kept}
    if all(law in laws for law in LAWS):
        row["ratio"] = at_equal_chatter(laws["dcarc"]["front"], laws["pid"]["front"])
    return row


def at_equal_chatter(front: Sequence[dict[str, Any]], other: Sequence[dict[str, Any]]) -> float | None:
    """Error over the ``other``'s, median over the front's chatters where both have a point as quiet."""
    ratios = []
    for point in front:
        quiet = [p["error"] for p in other if p["chatter"] <= point["chatter"]]
        if quiet:
            ratios.append(point["error"] / min(quiet))
    return float(np.median(ratios)) if ratios else None


def drawn_summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Results and accepted gains of each law, errors at equal chatter, and overshoots within WITHIN."""
    ratios = [row["ratio"] for row in rows if row.get("ratio") is not None]
    there = [row[law] for row in rows for law in ALL if law in row]
    within = [(one["verified"]["overshoot"] or math.inf) <= WITHIN for one in there]
    return {
        "valves": len(rows),
        "results": {law: sum(law in row for row in rows) for law in ALL},
        "accepted": {law: sum(bool(row.get(law, {}).get("accepted")) for row in rows) for law in ALL},
        "median_ratio": float(np.median(ratios)) if ratios else math.nan,
        "share_within_overshoot": float(np.mean(within)) if within else math.nan,
        "seconds": float(np.median([row["seconds"] for row in rows])) if rows else math.nan,
    }


def _drawn(folder: Path, seeds: Sequence[int], budget: int, path: str) -> None:
    """Tune around one valve after the other; what ``path`` has already is not done again."""
    lines = Path(path).read_text(encoding="utf-8").splitlines() if Path(path).is_file() else []
    rows = [json.loads(line) for line in lines]
    for seed in seeds:
        if seed not in [row["seed"] for row in rows]:
            place = folder / str(seed)
            place.mkdir()
            rows.append(tuned(place, seed, budget))
            with Path(path).open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(rows[-1]) + "\n")
    for key, value in drawn_summary(rows).items():
        print(f"{key:28}{value}")


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
    options.add_argument("--drawn", action="store_true", help="tune all laws around random valves")
    arguments = options.parse_args()
    Path(arguments.json).parent.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="valve_control-invented-") as name:
        if arguments.drawn:
            seeds = range(arguments.seed, arguments.seed + arguments.valves)
            _drawn(Path(name), seeds, arguments.budget, arguments.json)
            return 0

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
