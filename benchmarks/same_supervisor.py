# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Whether the supervisor of this checkout does what that of another commit does, bit for bit.

python -m benchmarks.same_supervisor [RUNS [COMMIT]]      300 random runs, against the last commit

Each run drives one valve through random faults of the LVDT, commands, trajectories, pauses, changes of law
and parameters, and laws that raise errors. After each event voltage, mode, sentences, counters and telemetry
are compared, after every twentieth all that the supervisor remembers.
"""

import json
import math
import os
import random
import subprocess
import sys
import tempfile
import types
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

COMMIT = "HEAD"
ROOT = Path(__file__).resolve().parents[1]
WORKERS = 2
PLANT = {"friction.coulomb": 1.16, "flow_force": 0.116, "lvdt.noise": 0.0056, "lvdt.resolution": 0.0037}
FAULTS = ("nan", "jump", "beyond", "frozen", "flipped", "half", "offset", "swing", "sound")
LASTING = ("flipped", "half", "swing", "sound")  # of a run in which each lasts long enough to be found


def settings(dice: random.Random) -> dict[str, Any]:
    """Changes of the controller's parameters."""
    from valve_control.control.laws.registry import LAWS

    return {
        "controller": dice.choice(list(LAWS)),
        "sample_period": dice.choice([0.001, 0.001, 0.001, 0.0005]),
        "command.lag": dice.choice([0.0, 0.0, 0.002]),
        "reshaping.lead": dice.choice([0.0, 0.0, 0.005]),
        "reshaping.lead_accel": dice.choice([0.0, 1.0]),
        "command_timeout": dice.choice([0.0, 0.02, 0.2]),
        "command_limit": dice.choice([2.0, 10.0]),
        "transfer_time": dice.choice([0.005, 0.05]),
        "lockstep": dice.random() < 0.15,
        "saturation_limit": dice.choice([0.01, 0.5]),
        "oscillation_limit": dice.choice([0.0, 0.02]),
        "u_max": dice.choice([3.0, 10.0]),
        "lvdt.hold_samples": dice.choice([0, 2, 10]),
        "lvdt.recovery_samples": dice.choice([1, 5, 20]),
        "lvdt.frozen_samples": dice.choice([0, 20]),
        "lvdt.hold_off": dice.choice([0.005, 0.05]),
        "lvdt.disturbance": dice.choice([0.0, 0.5, 2.0]),
    }


def failing(dice: random.Random) -> None:
    """Let each law raise an error or give NaN for a few commands, or in a gap."""
    from valve_control.control.laws.registry import LAWS

    for name, law in list(LAWS.items()):
        module, low = law.module, dice.uniform(0.5, 1.5)
        error = dice.choice([OverflowError, ZeroDivisionError, ValueError, None])

        def step(
            p: Any,
            s: Any,
            command: float,
            measurement: float,
            offset: float,
            *,
            of: Any = (module, low, error),
        ) -> Any:
            inner, least, kind = of
            if least < command < least + 0.05 and kind is not None:
                raise kind("a law that fails")
            voltage, s, terms = inner.step(p, s, command, measurement, offset)
            return (math.nan if least < command < least + 0.05 else voltage), s, terms

        def hold(
            p: Any,
            s: Any,
            command: float,
            measurement: float,
            voltage: float,
            *,
            of: Any = (module, low, error),
        ) -> Any:
            inner, least, kind = of
            if least < command < least + 0.2 and kind is not None:
                raise kind("a law that fails")
            return inner.hold(p, s, command, measurement, voltage)

        parts = {part: getattr(module, part) for part in ("Params", "State", "Terms", "initial")}
        made: Any = types.SimpleNamespace(**parts, step=step, hold=hold, __name__=module.__name__)
        LAWS[name] = law._replace(module=made)


def run(seed: int) -> Iterator[str]:
    """What the supervisor of this process says after each event of the run ``seed``."""
    from valve_control.control.laws import registry
    from valve_control.control.parameters import build
    from valve_control.control.parameters.table import CONTROLLER, VALVE
    from valve_control.control.plant import valve
    from valve_control.control.supervision.command_course import Motion
    from valve_control.control.supervision.state_snapshot import restore, snapshot
    from valve_control.control.supervision.supervisor import Supervisor
    from valve_control.parameter import ParameterError, defaults, updated

    dice = random.Random(seed)
    laws = dict(registry.LAWS)
    if dice.random() < 0.2:
        failing(dice)
    supervisor = Supervisor()
    supervisor.answered = dice.random() < 0.9
    values = defaults(CONTROLLER)

    def use(changes: dict[str, Any]) -> None:
        nonlocal values
        try:
            made = updated(CONTROLLER, values, changes)
            params = build.law_params(made)
        except ParameterError:
            return
        values = made
        supervisor.apply(values, params)

    use({})
    use(settings(dice))
    plant = build.valve_params(updated(VALVE, defaults(VALVE), PLANT))
    spool, number, count, shown = valve.initial(plant), 0, 0, 0.0
    voltage, amplitude, frequency = 0.0, dice.choice([0.0, 0.02, 0.5, 3.0, 9.0]), dice.uniform(0.5, 30.0)
    upper = dice.choice(["command", "command", "trajectory", "both", "none"])
    every = dice.choice([1, 2, 5, 13])
    handed: list[float] = []

    def said(event: str) -> str:
        nonlocal count
        count += 1
        parts = [event, voltage, handed[-1:], int(supervisor.mode), supervisor.reason, supervisor.conditions,
                 supervisor.memory.counts, supervisor.telemetry(), supervisor.memory.changed,
                 supervisor.bridged, supervisor.memory.command.value, supervisor.assumed,
                 supervisor.theta]  # fmt: skip
        if count % 20 == 0:
            parts += [snapshot(supervisor), supervisor.present_values()]
        supervisor.memory.changed = False
        return repr(parts)

    fault, left = "sound", dice.randrange(5, 200)
    period = float(values["sample_period"])  # type: ignore[arg-type]
    late = dice.choice([1.0, 1.0, 1.0, 1.03, 1.6]) * period
    calm = dice.random() < 0.08
    for k in range(3000 if calm else dice.choice([200, 300, 300, 400])):
        left -= 1
        if left <= 0 and calm:
            fault, left = dice.choice(LASTING), dice.randrange(300, 1500)
        elif left <= 0:
            fault, left = dice.choice(FAULTS), int(10 ** dice.uniform(0.0, 2.0))
            if dice.random() < 0.5:
                fault, left = "sound", int(10 ** dice.uniform(0.5, 2.3))
        t = k * period
        w = 2.0 * math.pi * frequency
        wanted = amplitude * (math.sin(w * t) if frequency < 20.0 else math.copysign(0.5, math.sin(w * t)))
        if k % every == 0 and upper in ("command", "both") and dice.random() < 0.95:
            value = dice.choice([math.nan, math.inf, 1e3]) if dice.random() < 0.01 else wanted
            supervisor.command(value, *dice.choice([(math.nan, 0.0), (1.0 + t, 0.3 * period)]))
            yield said("command")
        if k % every == 0 and upper in ("trajectory", "both") and dice.random() < 0.95:
            point = Motion(wanted, amplitude * w * math.cos(w * t), -w * w * wanted)
            if dice.random() < 0.01:
                point = point._replace(velocity=math.nan)
            stamp = 1.0 + t - (0.5 if dice.random() < 0.02 else 0.0)
            taken = supervisor.trajectory(point, dice.choice([math.nan, stamp]), 0.3 * period)
            yield said(f"trajectory {taken}")
        chance = dice.random() * (10.0 if calm else 1.0)
        if chance < 0.002:
            upper = dice.choice(["command", "trajectory", "both", "none"])
        elif chance < 0.005:
            supervisor.command_gone()
            yield said("gone")
        elif chance < 0.007:
            supervisor.trajectory_gone()
            yield said("trajectory gone")
        elif chance < 0.008:
            supervisor.trajectory_refused(1, 0, dice.randrange(3))
            yield said("trajectory refused")
        elif chance < 0.011:
            supervisor.reset()
            yield said("reset")
        elif chance < 0.014:
            voltage = supervisor.silence(dice.choice([0.005, 0.03, 0.5]), dice.random() < 0.5)
            yield said("silence")
        elif chance < 0.015:
            supervisor.start()
            voltage = supervisor.voltage
            yield said("start")
        elif chance < 0.019:
            use(settings(dice) if dice.random() < 0.5 else {"controller": dice.choice(list(laws))})
            yield said("apply")
        elif chance < 0.023:
            name = str(values["controller"])
            own = f"{name}.theta_initial"
            if own in values:
                initial: Any = values[own]
                use({own: [dice.uniform(0.9, 1.1) * number for number in initial]})
            else:
                use({"reshaping.natural_frequency": dice.uniform(200.0, 400.0)})
            yield said("gains")
        elif chance < 0.025:
            publishers = dice.choice(["command_publishers", "lvdt_publishers"])
            supervisor.observe(publishers, dice.choice(["", "2 publishers"]))
            yield said("publishers")
        elif chance < 0.027 and restore(supervisor, snapshot(supervisor)):
            yield said("restored")
        reading = valve.read(plant, spool, dice.gauss(0.0, 1.0))
        shown = shown if fault == "frozen" else reading
        spoilt = {"nan": math.nan, "jump": reading + 3.0, "beyond": 1e3, "frozen": shown, "flipped": -reading,
                  "half": 0.5 * reading, "offset": reading + 0.3,
                  "swing": reading + 0.1 * math.sin(90.0 * t), "sound": reading}[fault]  # fmt: skip
        lost = dice.choice([1, 2, 5, 30]) if dice.random() < (0.001 if calm else 0.01) else 0
        number += 1 + lost
        elapsed = 0.0 if values["lockstep"] or dice.random() < 0.02 else late * (1 + lost)
        sequence = None if dice.random() < 0.02 else number
        if dice.random() < 0.9:
            voltage = supervisor.sample(spoilt, sequence, elapsed, handed.append)
        else:
            voltage = supervisor.sample(spoilt, sequence, elapsed)
        yield said(f"sample {fault}")
        spool = valve.step(plant, spool, voltage)
    registry.LAWS.update(laws)


def measure(words: list[str]) -> None:
    """In a child: a line with the digests of each run, or with its texts."""
    first, last, step = (int(word) for word in words[:3])
    for seed in range(first, last, step):
        texts = list(run(seed))
        kept: list[Any] = texts if words[3:] else [zlib.crc32(text.encode()) for text in texts]
        print(json.dumps([seed, kept]), flush=True)


def child(tree: Path, *words: object) -> "subprocess.Popen[str]":
    """A process that runs the package in ``tree``."""
    command = [sys.executable, str(Path(__file__).resolve()), "--run", *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    return subprocess.Popen(command, cwd=tree, env=environment, stdout=subprocess.PIPE, text=True)


def results(trees: tuple[Path, Path], runs: int) -> Iterator[tuple[int, list[int], list[int]]]:
    """Digests of each run in both trees; the parts are computed side by side."""
    for part in range(WORKERS):
        children = [child(tree, part, runs, WORKERS) for tree in trees]
        outputs = [process.stdout for process in children]
        assert outputs[0] is not None and outputs[1] is not None
        for one, other in zip(*outputs, strict=True):
            (seed, old), (_, new) = json.loads(one), json.loads(other)
            yield seed, old, new
        for process in children:
            if process.wait() != 0:
                raise SystemExit("a run has failed")


def differences(trees: tuple[Path, Path], seed: int) -> str:
    """The first event of a run after which both trees differ, and what each says."""
    texts: list[list[str]] = []
    for tree in trees:
        out, _ = child(tree, seed, seed + 1, 1, "texts").communicate()
        texts.append(json.loads(out)[1])
    for i, (old, new) in enumerate(zip(*texts, strict=False)):
        if old != new:
            return f"run {seed}, event {i}:\n  before {old}\n  now    {new}"
    return f"run {seed}: {len(texts[0])} and {len(texts[1])} events"


def main(report: Callable[[str], None] = print) -> int:
    """Compare; 1 if a run differs."""
    if sys.argv[1:2] == ["--run"]:
        measure(sys.argv[2:])
        return 0
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    commit = sys.argv[2] if len(sys.argv) > 2 else COMMIT
    with tempfile.TemporaryDirectory(prefix="same_supervisor-") as name:
        archive = subprocess.run(["git", "-C", ROOT, "archive", commit], stdout=subprocess.PIPE, check=True)
        subprocess.run(["tar", "-x", "-C", name], input=archive.stdout, check=True)
        trees = (Path(name), ROOT)
        other, events = [], 0
        for seed, old, new in results(trees, runs):
            events += len(new)
            if old != new:
                other.append(seed)
        for seed in other[:3]:
            report(differences(trees, seed))
    report(f"{runs - len(other)} of {runs} runs, {events} events, are those of {commit} to the last bit")
    return int(bool(other))


if __name__ == "__main__":
    raise SystemExit(main())
